"""Plans in stages, and a planner whose points of interest are known, for tests."""

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.next_stage import plan_in_stages
from steradian.plans.stages import FocusStage, Proposal
from steradian.reconstructions.stages.planner import next_plan

APERTURE = 13.56e-3
PLACES = ((2.0e-3, -1.5e-3, 2.5e-3), (-3.0e-3, 1.0e-3, 3.0e-3))


def staged_plan(survey=24, *, decision="auto", samples=384, stopping=None, **parameters):
    """A plan of some 60 points that begins with a survey."""
    plan = ScanPlan.create(mask=equi_steradian_mask(APERTURE, 3.6e-3, 60), samples=samples, **parameters)
    return plan_in_stages(plan, survey, focus=FocusStage(points=5, decision=decision), stopping=stopping)


class KnownPlanner:
    """A planner that finds what it is told to find, and makes the next plan as ours does.

    Parameters
    ----------
    places
        (P, 3) what it finds.
    looked
        Called with the scan file's path at each proposal.
    """

    def __init__(self, places=PLACES[:1], looked=lambda path: None):
        self.places, self.looked = places, looked

    def propose(self, path, stage):
        self.looked(path)
        return tuple(Proposal(position=place, signal_to_noise=20.0) for place in self.places)

    def next_plan(self, plan, points):
        return next_plan(plan, points)

    def cancel(self):
        """Nothing is under way."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass
