"""Images and proposals between the stages of a scan."""
