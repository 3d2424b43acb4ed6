"""How all pictures look: one style for pages of plots (matplotlib) and for projections drawn straight into pixels."""
