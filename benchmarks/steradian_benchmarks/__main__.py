"""Command line of the benchmarks: ``python -m steradian_benchmarks``."""

from steradian_benchmarks.commands import app

if __name__ == "__main__":
    app()
