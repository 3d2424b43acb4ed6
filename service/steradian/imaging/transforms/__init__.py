"""Non-uniform transforms in tables: windows, sizes, sensors on the lateral grid, time to depth along one mode."""
