"""Array storage: local files or an object store, with a cache."""
