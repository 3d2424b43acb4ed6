"""Mutants of the job queue: turns, matching, estimates, the ledger, versions of requests, child processes."""

from support.mutants import Mutant

MUTANTS = {
    "an owner's next job has the same turn": Mutant(
        "jobs.queue.fair_queueing:next_start_tag",
        "own + 1",
        "own",
        ("jobs/test_turns.py::test_the_worker_takes_them_in_turns_and_their_places_say_so",),
    ),
    "a new owner begins at the end": Mutant(
        "jobs.queue.fair_queueing:next_start_tag",
        "func.min(turn)",
        "func.max(turn)",
        ("jobs/test_turns.py::test_fair_queueing_ignores_other_jobs_of_same_owner[nothing]",),
    ),
    "turns of all priorities together": Mutant(
        "jobs.queue.fair_queueing:next_start_tag",
        ", JobRow.priority == priority",
        "",
        ("jobs/test_turns.py::test_fair_queueing_ignores_other_jobs_of_same_owner[a job in the background]",),
    ),
    "cores are not asked for": Mutant(
        "jobs.queue.matching:Capabilities.satisfies",
        "wanted.cores <= self.cores",
        "True",
        (
            "jobs/test_capabilities.py::test_unsatisfiable_requirements_are_refused_with_capabilities[wanted4-requires.cores]",
        ),
    ),
    "every worker has a GPU": Mutant(
        "jobs.queue.matching:Capabilities.satisfies",
        "self.gpu is not None or not wanted.gpu",
        "True",
        ("jobs/test_capabilities.py::test_a_gpu_that_no_worker_has_is_refused_by_the_parameter_that_asks_for_it",),
    ),
    "clocks far ahead are believed": Mutant(
        "jobs.queue.matching:present_workers",
        "now + PRESENCE_TIMEOUT",
        "now + EXPIRY",
        ("jobs/test_capabilities.py::test_worker_with_large_clock_skew_is_not_present[ahead1]",),
    ),
    "any scanner's workers": Mutant(
        "jobs.queue.matching:eligible_workers",
        " if has.scanner_id in {None, scanner_id}",
        "",
        ("jobs/test_capabilities.py::test_scanner_worker_counts_only_for_live_jobs_of_its_scanner",),
    ),
    "refused before a worker was there": Mutant(
        "jobs.queue.matching:require_satisfiable",
        "not known or any",
        "any",
        ("jobs/test_capabilities.py::test_where_no_worker_was_here_lately_nothing_is_refused",),
    ),
    "an old start still counts": Mutant(
        "jobs.queue.job_ledger:JobLedger._fenced",
        "row.fence != fence",
        "row.fence < fence",
        ("jobs/test_fencing.py::test_stale_fence_update_is_refused[wanted-success]",),
    ),
    "numbers of starts begin anew after a restore": Mutant(
        "jobs.queue.job_ledger:JobLedger.start_attempt",
        "max(row.fence, after) + 1",
        "row.attempt",
        ("jobs/test_fencing.py::test_a_number_is_not_used_again_after_a_start_was_put_back",),
    ),
    "an interruption counts as an attempt": Mutant(
        "jobs.queue.job_ledger:JobLedger._put_back",
        "row.attempt - 1",
        "row.attempt",
        ("jobs/test_fencing.py::test_interruptions_are_not_counted_as_attempts_but_do_not_go_on_for_ever",),
    ),
    "interrupted for ever": Mutant(
        "jobs.queue.job_ledger:JobLedger._close_attempt",
        "+ 1 < MAX_INTERRUPTIONS",
        "< 0 or True",
        ("jobs/test_fencing.py::test_interruptions_are_not_counted_as_attempts_but_do_not_go_on_for_ever",),
    ),
    "requests of the future": Mutant(
        "jobs.request_versions:current",
        "form != FORM",
        "form < FORM",
        ("jobs/test_forms.py::test_unknown_request_form_is_refused_with_form_name[2]",),
    ),
    "stored without its form": Mutant(
        "jobs.request_versions:stored",
        "KEY: FORM, ",
        "",
        ("jobs/test_forms.py::test_job_of_stores_the_form_of_its_request_and_current_reads_it",),
    ),
    "a scan's time is the job's": Mutant(
        "jobs.worker.process:JobProcess.run",
        "if stage == follows:",
        "if False:",
        ("jobs/test_process.py::test_the_time_of_a_scan_that_is_followed_is_not_the_jobs",),
    ),
    "backlog without jobs of unknown kinds": Mutant(
        "jobs.queue.estimates:backlog",
        "work = waiting * sum",
        "work = sum",
        ("api/test_queue_place.py::test_queue_expected_end_is_computed_from_past_job_durations",),
    ),
    "jobs that no worker can do are ahead": Mutant(
        "jobs.queue.estimates:_skipped",
        " if able else []",
        " if not able else []",
        ("jobs/test_capabilities.py::test_unsatisfiable_job_does_not_block_queue_position",),
    ),
}
