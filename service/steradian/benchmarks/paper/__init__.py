"""The paper's experiments done again with simulated data, with its figures beside ours."""

from steradian.benchmarks.paper.run import paper

__all__ = ["paper"]
