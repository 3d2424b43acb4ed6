"""Foundation without domain knowledge: exceptions, validation, units, files, processes, settings."""
