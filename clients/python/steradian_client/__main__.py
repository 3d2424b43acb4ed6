"""``python -m steradian_client``."""

from steradian_client.cli import main

if __name__ == "__main__":
    main()
