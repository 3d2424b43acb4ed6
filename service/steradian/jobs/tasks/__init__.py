"""Task handlers of the job kinds, and the context in which they run."""
