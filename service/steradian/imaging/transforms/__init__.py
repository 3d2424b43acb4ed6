"""Tables of the non-uniform transforms."""
