"""Values made to hurt are named; the table of those that are only refused is in :mod:`attacks`."""

import pytest


@pytest.mark.parametrize("text", ["\\u0000", "\\ud800", "\\udc00\\ud800"], ids=["nul", "half", "wrong way round"])
def test_import_description_with_unstorable_code_point_returns_400(http, text):
    about = f'{{"kind":"import","upload_id":"u1","description":{{"a":[{{"b{text}":1}}]}}}}'
    answer = http.post("/jobs", content=about, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["code"]) == (400, "malformed-json"), answer.text
    assert "U+" in answer.json()["detail"]


def test_a_pair_of_surrogates_and_a_backslash_before_u_are_characters(http):
    about = '{"kind":"import","upload_id":"u1","description":{"a":"\\ud83d\\ude00","b":"\\\\u0000"}}'
    answer = http.post("/jobs", content=about, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["detail"]) == (404, "there is no upload 'u1'"), answer.text


def test_json_duplicate_key_returns_400_naming_key(http):
    answer = http.post(
        "/plans",
        content='{"mask_id":"m1","motion":{"settle":1,"settle":2}}',
        headers={"Content-Type": "application/json"},
    )
    assert answer.status_code == 400
    assert "'settle'" in answer.json()["detail"]


@pytest.mark.parametrize(("wanted", "status"), [("bytes=99999999-", 416), ("bytes=abc", 400), ("bytes=5-2", 400)])
def test_unsatisfiable_or_invalid_range_returns_problem(http, scan_with_alines, wanted, status):
    answer = http.get(f"/scans/{scan_with_alines['scan']['id']}/file", headers={"Range": wanted})
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    if status == 416:
        assert answer.headers["content-range"].startswith("bytes */")


def test_a_method_that_is_not_there_names_all_that_are(http, scan):
    def allowed(path):
        answer = http.request("PROPFIND", path)
        assert answer.status_code == 405
        return {method.strip() for method in answer.headers["allow"].split(",")}

    assert allowed("/masks") >= {"GET", "POST"}
    assert allowed(f"/scans/{scan['id']}") >= {"GET", "PATCH"}
    assert allowed("/scanners/scanner-0/emergency-stop") >= {"POST", "DELETE"}
    assert allowed("/plans/preview") == {"POST"}, "it is no plan"
