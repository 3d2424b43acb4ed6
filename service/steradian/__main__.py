"""Run the command-line interface with ``python -m steradian``."""

from steradian.cli import main

if __name__ == "__main__":
    main()
