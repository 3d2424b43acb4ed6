"""The service's nouns, each a class of its own."""
