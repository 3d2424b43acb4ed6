"""Reproduction of the paper's experiments with simulated data, with the paper's figures beside ours."""

from steradian_benchmarks.paper.run import paper

__all__ = ["paper"]
