"""Values made to hurt get a problem document that names them, never a failure of the service."""

import pytest

HUGE = "1" + 400 * "0"


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (f'{{"arrangement":"points","aperture":0.01,"positions":[[{HUGE},0]]}}', 422, "invalid-input"),
        (f'{{"arrangement":"points","aperture":{HUGE},"positions":[[0,0]]}}', 422, "invalid-input"),
        ('{"arrangement":"points","aperture":0.01,"positions":false}', 422, "invalid-input"),
        ('{"arrangement":"poisson-disc","aperture":0.01,"spacing":5e-324}', 422, "invalid-input"),
        ('{"arrangement":"hexagonal","aperture":0.01,"interval":5e-324}', 422, "invalid-input"),
        (
            '{"arrangement":"grid","aperture":0.011,"count":3,"interval":1e-3,"aperture":0.012}',
            400,
            "malformed-json",
        ),
        ('{"arrangement":"grid","aperture":0.011,"count":%s,"interval":1e-3}' % ("9" * 5000), 400, "malformed-json"),
        ("[" * 100_000, 413, "too-large"),
        ("[" * 10_000, 400, "malformed-json"),
        ('{"arrangement":"grid","aperture":0.011,"count":3,"interval":1e-3,"a":"\\u0000"}', 400, "malformed-json"),
    ],
    ids=[
        "position 1e400",
        "aperture 1e400",
        "no list",
        "smallest spacing",
        "smallest interval",
        "a key twice",
        "5,000 digits",
        "too deep and long",
        "too deep",
        "nul",
    ],
)
def test_bodies(http, body, status, code):
    answer = http.post("/masks", content=body, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("text", ["\\u0000", "\\ud800", "\\udc00\\ud800"], ids=["nul", "half", "wrong way round"])
def test_an_import_whose_description_no_database_can_look_into_is_refused(http, text):
    about = f'{{"kind":"import","upload_id":"u1","description":{{"a":[{{"b{text}":1}}]}}}}'
    answer = http.post("/jobs", content=about, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["code"]) == (400, "malformed-json"), answer.text
    assert "U+" in answer.json()["detail"]


def test_a_pair_of_surrogates_and_a_backslash_before_u_are_characters(http):
    about = '{"kind":"import","upload_id":"u1","description":{"a":"\\ud83d\\ude00","b":"\\\\u0000"}}'
    answer = http.post("/jobs", content=about, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["detail"]) == (404, "there is no upload 'u1'"), answer.text


def test_a_key_that_stands_twice_is_named(http):
    answer = http.post(
        "/plans",
        content='{"mask_id":"m1","motion":{"settle":1,"settle":2}}',
        headers={"Content-Type": "application/json"},
    )
    assert answer.status_code == 400
    assert "'settle'" in answer.json()["detail"]


@pytest.mark.parametrize("identifier", ["𝟏" * 64, "é" * 64, "a" * 64, "..%2F..%2Fsteradian.sqlite", "%00"])
def test_identifiers_of_uploads(http, identifier):
    answer = http.get(f"/uploads/{identifier}")
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")
    assert http.delete(f"/uploads/{identifier}").status_code in {204, 404}


@pytest.mark.parametrize("name", ["masks", "plans", "scans", "reconstructions", "batches", "jobs", "scanners"])
@pytest.mark.parametrize(
    "identifier", ["𝟏" * 64, "%00", "%ff%fe", "x%00y"], ids=["digits", "nul", "no utf-8", "x nul y"]
)
def test_identifiers(http, name, identifier):
    answer = http.get(f"/{name}/{identifier}")
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")


@pytest.mark.parametrize("digits", ["1" * 5000, "𝟏", "-1"])
def test_a_version_that_is_none_is_outdated(http, scan, digits):
    tag = f'"{scan["id"]}-{digits}"'.encode()
    answer = http.patch(f"/scans/{scan['id']}", json={"labels": {"a": "b"}}, headers={b"If-Match": tag})
    assert (answer.status_code, answer.json()["code"]) == (412, "precondition-failed")


@pytest.mark.parametrize(("wanted", "status"), [("bytes=99999999-", 416), ("bytes=abc", 400), ("bytes=5-2", 400)])
def test_ranges_that_cannot_be_had_are_problems(http, scan_with_alines, wanted, status):
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
