"""Version of the form of stored requests."""

import json

import pytest

from steradian.core.exceptions import Conflict
from steradian.jobs import request_versions as forms
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.requests import EXAMPLES, to_job_request


def test_job_of_stores_the_form_of_its_request_and_current_reads_it():
    wanted = ReconstructionRequest.create(scan_id="s1", parameters={"method": "iterative"})
    kept = json.loads(json.dumps(to_job_request("r1", wanted).payload))
    assert kept["form"] == forms.FORM
    assert ReconstructionRequest.create(**forms.current(kept)) == wanted
    assert "form" not in forms.asked(kept)


@pytest.mark.parametrize("form", [2, 0, -1, "1", True, None])
def test_unknown_request_form_is_refused_with_form_name(form):
    with pytest.raises(Conflict, match=f"form of the job's request is {form!r}; allowed: 1;"):
        JOB_TYPES["export"].run(None, EXAMPLES["export"] | {"form": form})
