"""How all pictures look: one style for what is drawn straight into pixels and for plots of matplotlib."""
