"""The compiled engine: cells of 16 signals, three passes over one block of memory (docs/adr/0004-own-transforms.md)."""
