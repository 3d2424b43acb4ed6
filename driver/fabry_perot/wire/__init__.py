"""Wire format: frames, messages, encodings and states (``PROTOCOL.md``)."""
