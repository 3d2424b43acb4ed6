"""Entry point of ``python -m steradian_client``, which runs the command line."""

from steradian_client.cli import main

if __name__ == "__main__":
    main()
