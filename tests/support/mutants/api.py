"""Mutants of the HTTP API: keys, origins, stops, conditional requests, slices, caches, filters, admission."""

from support.mutants import Mutant

ATTACK = "api/test_attacks.py::test_an_attack_is_refused_with_the_right_problem"

MUTANTS = {
    "weak tags do not match": Mutant(
        "api.http.conditional:ReadPreconditions.tag",
        "contains_weak(name)",
        "contains(name)",
        ("api/test_conventions.py::test_get_route_follows_declared_http_conventions[/api/v1/masks/{mask_id}]",),
    ),
    "If-Match of another version is ignored": Mutant(
        "api.http.conditional:WritePreconditions.revision",
        "return int(found[1])",
        "return None",
        ("api/test_data.py::test_label_change_with_stale_if_match_returns_412",),
    ),
    "two prefixes are believed": Mutant(
        "api.http.urls:stated_prefix",
        "if len(given) == 1 else",
        "if given else",
        ("api/test_addresses.py::test_two_headers_are_ignored",),
    ),
    "a prefix that is no path": Mutant(
        "api.http.urls:stated_prefix",
        " and _PATH.fullmatch(path)",
        "",
        ("api/test_addresses.py::test_a_header_that_is_no_plain_path_is_ignored",),
    ),
    "a ticket releases the stop": Mutant(
        "api.middleware.stop_authorization:is_stop",
        'method == "POST" and',
        'method != "PUT" and',
        ("api/test_stop_ticket.py::test_stop_ticket_on_any_other_route_is_refused",),
    ),
    "scopes are not asked for": Mutant(
        "api.middleware.authentication:AuthorizedRoute.get_route_handler",
        "not principal.may(need)",
        "False",
        (f"{ATTACK}[POST /api/v1/jobs with the scope operate]",),
    ),
    "origins of changes are not asked for": Mutant(
        "api.middleware.authentication:AuthenticationMiddleware._check_origin",
        'origin.partition("://")[2] != host',
        "False",
        (f"{ATTACK}[a mask by a page of https://evil.example]",),
    ),
    "any host name": Mutant(
        "api.middleware.authentication:AuthenticationMiddleware._check_origin",
        "_is_loopback(name) or name in self._hosts",
        "True",
        (f"{ATTACK}[POST to the host '127.1']",),
    ),
    "any page reads": Mutant(
        "api.middleware.cors:is_read_of",
        ' and headers.get("origin", "").lower() in origins',
        "",
        ("api/test_cors.py::test_a_page_that_is_not_named_reads_nothing",),
    ),
    "no token against other pages": Mutant(
        "api.http.session_cookie:check_same_origin",
        'not hmac.compare_digest(headers.get(TOKEN, "").encode(), seen.csrf_token.encode())',
        "False",
        ("api/test_sessions.py::test_another_page_changes_nothing_with_the_cookie[X-CSRF-Token: None]",),
    ),
    "a cookie for scripts": Mutant(
        "api.http.session_cookie:set_cookie",
        "httponly=True",
        "httponly=False",
        ("api/test_sessions.py::test_a_cookie_is_as_good_as_its_key_and_no_script_reads_it",),
    ),
    "text of labels ends the name": Mutant(
        "api.params.filters:parse_labels",
        'label.partition("=")',
        'label.rpartition("=")',
        ("api/test_filters.py::test_labels_may_be_called_anything",),
    ),
    "misspelt parameters are ignored": Mutant(
        "api.params.filters:reject_unknown_query_params",
        "if unknown:",
        "if not unknown:",
        ("api/test_filters.py::test_misspelt_parameters_are_refused_everywhere",),
    ),
    "an index beyond the end": Mutant(
        "api.http.array_response:ArraySlice.parse",
        "not -size <= at < size",
        "at < -size",
        ("api/test_data.py::test_a_slice_that_is_none_is_refused[9999]",),
    ),
    "bytes are cut, not rounded": Mutant(
        "api.http.volume_params:Window.apply",
        "np.rint(",
        "np.floor(",
        ("api/test_volume_numbers.py::test_bytes_go_by_the_window",),
    ),
    "an answer outlives its validator": Mutant(
        "api.middleware.response_cache:_ResponseCache.get",
        "or kept != stamp",
        "",
        ("api/test_together.py::test_cached_response_is_kept_until_validator_changes",),
    ),
    "one caller's answer for all": Mutant(
        "api.middleware.response_cache:_key",
        'scope["query_string"], principal,',
        'scope["query_string"],',
        ("api/test_together.py::test_cached_response_is_kept_until_validator_changes",),
    ),
    "a key twice in an object": Mutant(
        "api.middleware.json_body:_object",
        "len(found) != len(pairs)",
        "False",
        ("api/test_hostile_values.py::test_json_duplicate_key_returns_400_naming_key",),
    ),
    "marks of another file": Mutant(
        "api.background.scan_row_changes:RowDeltaTracker.changed_since",
        "epoch == file.epoch and ",
        "",
        ("api/test_shots.py::test_a_mark_that_is_not_known_any_more_brings_everything[00000000.1]",),
    ),
    "uploads that an import waits for": Mutant(
        "api.background.retention:_forget_uploads",
        " or waiting_import(context.database, upload) is not None",
        "",
        ("jobs/test_retention.py::test_an_upload_that_an_import_waits_for_stays_until_it_is_over",),
    ),
    "results that a job still reads": Mutant(
        "api.background.retention:_delete_jobs_before",
        " if row.id not in kept",
        "",
        ("jobs/test_retention.py::test_a_result_that_a_waiting_job_has_still_to_read_stays_until_that_is_over",),
    ),
    "an upload at any offset": Mutant(
        "api.http.resumable_uploads:Part.open",
        "size != offset",
        "False",
        ("api/test_resumable_uploads.py::test_part_at_another_offset_than_its_size_is_refused[3]",),
    ),
    "scans without A-lines": Mutant(
        "api.use_cases.admission:_check_alines",
        "not is_there or not",
        "False and not",
        ("api/test_resources.py::test_reconstruction_of_a_scan_without_alines_is_refused",),
    ),
    "volumes of any size": Mutant(
        "api.use_cases.admission:_check_size",
        "if size > limit:",
        "if size < 0:",
        ("api/test_depths.py::test_reconstruction_of_more_depth_than_a_volume_may_have_is_refused_by_its_range",),
    ),
}
