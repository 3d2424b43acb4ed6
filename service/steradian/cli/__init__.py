"""The command line: the same nouns as everywhere, without a server where none is needed."""

from steradian.cli.app import main

__all__ = ["main"]
