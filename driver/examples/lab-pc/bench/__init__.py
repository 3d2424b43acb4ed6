"""What the example needs of a lab, made up."""
