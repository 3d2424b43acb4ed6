"""The bytes on the line: frames, messages, encodings, and the states they tell of (``PROTOCOL.md``)."""
