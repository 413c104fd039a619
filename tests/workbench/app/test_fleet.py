"""A survey's page and those of its cases, as the server gives them; the browser walks them in `test_browser.py`."""

import pytest

from tests.workbench.app.fleets import repeat, surveyed
from tests.workbench.pages import Page, values
from workbench.app.page.server import make_app
from workbench.survey import Dataset, Fleet
from workbench.survey.page import render

OTHERS = ({"Host": "rebound.example"}, {"Origin": "https://other.example"}, {"Origin": "null"})


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return surveyed(tmp_path_factory.mktemp("fleet"))


@pytest.fixture
def client(survey: Dataset):
    app, sessions = make_app(survey=survey.folder)
    yield app.server.test_client()
    sessions.close()


def links(text: str) -> list[str]:
    return [href for href in values(Page(text), "href") if not href.startswith("#")]


def without_home(text: str) -> str:
    return "".join(line for line in text.splitlines() if 'id="home"' not in line)


def test_the_page_is_the_survey_s_own_with_a_way_home_and_to_its_cases(client, survey):
    served = client.get("/fleet/").text
    home, case = links(served)
    assert home == "/" and (survey.folder / case).is_file()  # relative, so that it leads to /fleet/reports/
    own = render(Fleet.of(survey), survey.folder)
    assert without_home(served).split("Written by")[0] == without_home(own).split("Written by")[0]
    with client.get(f"/fleet/{case}") as answer:
        assert answer.data == (survey.folder / case).read_bytes()


def test_the_page_tells_what_the_dataset_holds_by_now(client, survey):
    assert "survey of 2 recordings" in client.get("/fleet/").text.lower()
    repeat(survey, 2)
    assert "survey of 3 recordings" in client.get("/fleet/").text.lower()


def test_pages_are_for_this_computer_and_a_case_s_own_may_ask_for_nothing(client, survey):
    (case,) = links(client.get("/fleet/").text)[1:]
    for path in ("/fleet/", f"/fleet/{case}"):
        assert [client.get(path, headers=headers).status_code for headers in OTHERS] == [403] * len(OTHERS)
        with client.get(path) as answer:
            policies = answer.headers.getlist("Content-Security-Policy")
        assert any("default-src 'self'" in policy and "frame-ancestors 'none'" in policy for policy in policies)
    # without an origin of its own, so that what it posts to the workbench comes from "null", which is refused
    assert any(policy.startswith("sandbox") and "allow-same-origin" not in policy for policy in policies)


@pytest.mark.parametrize("name", ["../SURVEY", "..%2fSURVEY", "%2e%2e/SURVEY", "..\\SURVEY", "reports/../../SURVEY"])
def test_nothing_but_the_pages_of_cases_is_given(client, survey, name):
    told = (survey.folder / "SURVEY").read_text().strip()
    assert told and told not in client.get(f"/fleet/reports/{name}").text
    assert client.get("/fleet/reports/none.html").status_code == 404


def test_a_server_without_a_survey_has_no_such_page(survey):
    app, sessions = make_app()
    client = app.server.test_client()
    assert "Survey of" not in client.get("/fleet/").text
    assert "to-fleet" not in client.get("/_dash-layout").text
    sessions.close()
