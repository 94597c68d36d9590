"""Checks of headphones, shares of the trials, and the listeners' rights over their answers."""

from __future__ import annotations

import io
import json
from collections import Counter
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest
import soundfile
from listening_fakes import made, request

from tonewood.workshop.batch.pages import HeadphonesPage
from tonewood.workshop.listening import headphones
from tonewood.workshop.listening.answer_file import WITHDRAWN, answers_of, begin, free_place
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.results import analyse
from tonewood.workshop.listening.server import ListeningServer
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.trials import CHANGED

CHECK = {"type": "headphones", "back": {"code": "NO", "address": "https://crowd.example/?c={code}"}}
PAIRS = {"type": "abx", "pairs": {"pluck": "all"}}
FS = 48000


def test_huggins_pitch_is_noise_for_each_ear_and_a_band_in_antiphase() -> None:
    random = np.random.default_rng(3)
    plain, pitched = (headphones.huggins(FS, pitch, random) for pitch in (False, True))
    assert np.array_equal(plain[:, 0], plain[:, 1])
    left, right = np.fft.rfft(pitched, axis=0).T
    assert np.allclose(np.abs(left), np.abs(right))  # either ear alone hears noise
    opposite = np.real(left * np.conj(right)) < 0
    assert np.flatnonzero(opposite)[[0, -1]].tolist() == [564, 636]  # 600 Hz +- 6 %, bins of 1 Hz
    assert opposite.sum() == 73


def test_tones_in_antiphase_vanish_where_the_channels_meet() -> None:
    usual, softer, opposite = (headphones.tone(FS, s, o) for s, o in ((False, False), (True, False), (False, True)))
    rms = [np.sqrt(np.mean(x**2)) for x in (usual, softer, opposite)]
    assert 20 * np.log10(rms[1] / rms[0]) == pytest.approx(-6.0)
    assert rms[2] == pytest.approx(rms[0])
    assert np.abs(opposite.sum(axis=1)).max() < 1e-12


@pytest.mark.parametrize("method", ["huggins", "antiphase"])
def test_intervals_of_a_session_hold_one_that_is_to_be_found(tmp_path: Path, method: str) -> None:
    test = made(tmp_path, [CHECK | {"method": method}, PAIRS])
    page = test.pages[0]
    assert isinstance(page, HeadphonesPage)
    session = Session(test, 5)
    sounds = {}
    for slot in ("1", "2", "3"):
        raw = headphones.interval(test, page, session, slot)
        assert raw == headphones.interval(test, page, session, slot)
        sounds[slot], fs = soundfile.read(io.BytesIO(raw))
        assert fs == FS
    (odd,) = [slot for slot in sounds if session.step is not None and session.step.slots[slot] == CHANGED]
    difference = {slot: np.std(s[:, 0] - s[:, 1]) for slot, s in sounds.items()}
    if method == "huggins":
        assert max(difference, key=lambda slot: difference[slot]) == odd
        level = 20 * np.log10(np.std(sounds[odd][5000:-5000, 0]))
        assert level == pytest.approx(-23.0 - 3.01, abs=0.1)
    else:
        assert min(sounds, key=lambda slot: np.std(sounds[slot][:, 0])) == odd
        assert max(difference, key=lambda slot: difference[slot]) != odd


def taken(session: Session, right: int) -> None:
    """Answer one check, so many trials right."""
    for k in range(6):
        assert session.step is not None
        wrong = next(slot for slot in session.step.slots if slot != session.step.correct)
        session.answer({"choice": session.step.correct if k < right else wrong})


def test_a_check_is_passed_taken_again_or_ends_the_test(tmp_path: Path) -> None:
    test = made(tmp_path, [CHECK, PAIRS])
    passes, again, fails = (Session(test, 1) for _ in range(3))
    taken(passes, 6)
    assert passes.page is not None
    assert passes.page.type == "abx"
    taken(again, 5)
    assert again.page is not None
    assert again.page.type == "headphones"
    taken(again, 6)
    assert again.page.type == "abx"
    taken(fails, 5)
    taken(fails, 0)
    assert (fails.step, fails.failed) == (None, 0)


@pytest.mark.parametrize("size", [1, 2])
def test_subsets_give_every_trial_to_as_many_listeners(tmp_path: Path, size: int) -> None:
    test = made(tmp_path, [PAIRS | {"subset": size}])
    n = len(test.trials)
    counts: Counter[str] = Counter()
    companies = set()
    for place in range(4 * n):
        session = Session(test, 1000 + place, place)
        own = set()
        while session.step is not None and session.step.trial:
            own.add(session.step.trial)
            session.answer({"choice": "A"})
        assert len(own) == size
        counts.update(own)
        companies.add(frozenset(own))
        assert max(counts.values()) - min(counts.get(t.id, 0) for t in test.trials) <= 2
    assert set(counts.values()) == {4 * size}
    assert len(companies) > 1


@pytest.fixture(scope="module")
def test(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    back = {"code": "C-{id}", "address": "https://crowd.example/done?cc={code}&p={listener}"}
    return made(tmp_path_factory.mktemp("rights"), [CHECK, PAIRS | {"subset": 1}, {"type": "finish", "back": back}])


def call(application: Any, method: str, path: str, data: Any = None) -> tuple[int, Any]:
    status, _, raw = request(application, method, path, b"" if data is None else json.dumps(data).encode())
    return status, json.loads(raw)


def test_a_listener_gets_the_code_at_the_end_only_and_all_answers_on_request(test: ListeningTest) -> None:
    application = ListeningServer(test).application()
    _, begun = call(application, "POST", "/api/session", {"listener": "a b/1"})
    path = f"/api/session/{begun['token']}"
    shown = []
    while (step := call(application, "GET", path)[1])["type"] not in ("done", "failed"):
        shown.append(json.dumps(step))
        found = Session(test, answers_of(test).listeners[-1].header["seed"], 0)
        for record in answers_of(test).listeners[-1].records:
            found.take(record)
        assert found.step is not None
        choice = found.step.correct or "A"
        status, reply = call(application, "POST", path, {"index": step["index"], "choice": choice})
        assert status == 200, reply
    code = f"C-{begun['token'][:8]}"
    assert not any("crowd.example" in text or code in text for text in shown)
    assert (step["code"], step["address"]) == (code, f"https://crowd.example/done?cc={code}&p=a%20b%2F1")
    status, own = call(application, "GET", f"{path}/data")
    assert status == 200
    assert own["listener"] == "a b/1"
    assert [one["type"] for one in own["answers"]] == ["headphones"] * 6 + ["abx", "finish"]
    secrets = ("slots", "correct", "right", "trial", "level", *(t.id for t in test.trials))
    assert not any(f'"{secret}"' in json.dumps(own) for secret in secrets)


def test_long_names_of_a_panel_are_whole_or_refused(tmp_path: Path) -> None:
    """In the way back and in the results; a hash in hexadecimal digits has 64."""
    finish = {"type": "finish", "back": {"code": "C", "address": "https://crowd.example/?p={listener}"}}
    test = made(tmp_path, [PAIRS | {"subset": 1}, finish])
    application = ListeningServer(test).application()
    name = "0123456789abcdef" * 4 + "zz"
    _, begun = call(application, "POST", "/api/session", {"listener": name})
    path = f"/api/session/{begun['token']}"
    for index in range(2):
        assert call(application, "POST", path, {"index": index, "choice": "A"})[0] == 200
    assert call(application, "GET", path)[1]["address"] == f"https://crowd.example/?p={name}"
    assert [one.listener for one in answers_of(test).listeners] == [name]
    status, reply = call(application, "POST", "/api/session", {"listener": "x" * 201})
    assert (status, reply) == (400, {"error": "listener: has 201 characters, 200 are allowed"})
    assert len(answers_of(test).listeners) == 1


def test_who_withdraws_leaves_no_answer_and_gives_the_place_back(tmp_path: Path, test: ListeningTest) -> None:
    test = made(tmp_path, [PAIRS | {"subset": 1}])
    application = ListeningServer(test).application()
    tokens = [call(application, "POST", "/api/session", {"listener": name})[1]["token"] for name in "ab"]
    assert sorted(one.header["place"] for one in answers_of(test).listeners) == [0, 1]
    call(application, "POST", f"/api/session/{tokens[0]}", {"index": 0, "choice": "A"})
    assert call(application, "DELETE", f"/api/session/{tokens[0]}") == (200, {"withdrawn": True})
    folder = test.folder / "answers"
    assert [path.stem for path in folder.glob("*.jsonl")] == [tokens[1]]
    assert not any(tokens[0].encode() in path.read_bytes() for path in folder.iterdir())
    assert json.loads((folder / WITHDRAWN).read_text())["answers"] == 1
    for method in ("GET", "POST", "DELETE"):
        assert call(application, method, f"/api/session/{tokens[0]}", {"index": 1, "choice": "A"})[0] == 404
    assert free_place(test) == 0
    call(application, "POST", f"/api/session/{tokens[1]}", {"index": 0, "choice": "A"})
    assert analyse(test.folder).withdrawn == 1


def test_a_damaged_session_can_be_withdrawn(tmp_path: Path) -> None:
    test = made(tmp_path, [PAIRS])
    opened = begin(test, language="en", listener="x", started="2026-01-01T00:00:00")
    opened.path.write_bytes(opened.path.read_bytes() + b"{}\n")
    application = ListeningServer(test).application()
    assert call(application, "GET", f"/api/session/{opened.path.stem}")[0] == 410
    assert call(application, "DELETE", f"/api/session/{opened.path.stem}")[0] == 200
    assert not opened.path.exists()


def test_another_page_cannot_have_answers_deleted(test: ListeningTest) -> None:
    opened = begin(test, language="en", listener="x", started="2026-01-01T00:00:00")
    application = ListeningServer(test).application()
    path = f"/api/session/{opened.path.stem}"
    assert request(application, "DELETE", path, headers={"Origin": "https://evil.example"})[0] == 403
    assert opened.path.exists()


@pytest.mark.parametrize(
    ("changes", "given", "status"),
    [
        ({}, {"heard": {"A": 0.6, "B": 0.5, "X": 1.0}}, 200),
        ({}, {"heard": {"A": 0.6, "B": 0.4, "X": 1.0}}, 400),
        ({}, {"heard": {"A": 0.6, "B": 0.6}}, 400),
        ({"listen": 0.0}, {"heard": {"A": 0.0, "B": 0.0, "X": 0.0}}, 200),
        ({"plays": 2}, {"plays": {"A": 2, "B": 1, "X": 1}, "heard": {"A": 0.1, "B": 0.5, "X": 0.5}}, 200),
        ({"plays": 2}, {"plays": {"A": 2, "B": 1, "X": 1}, "heard": {"A": 0.1, "B": 0.1, "X": 0.5}}, 400),
        ({"plays": 2}, {"plays": {"A": 1, "B": 1, "X": 1}, "heard": {"A": 0.1, "B": 0.5, "X": 0.5}}, 400),
        ({"plays": 2}, {"plays": {"A": 2, "B": 1, "X": 1}}, 200),
        ({"plays": 2}, {"plays": {"A": 3, "B": 1, "X": 1}}, 400),
    ],
)
def test_shares_and_counts_are_those_of_the_page(
    tmp_path: Path, changes: dict[str, Any], given: dict[str, Any], status: int
) -> None:
    test = made(tmp_path, [PAIRS | changes])
    application = ListeningServer(test).application()
    token = call(application, "POST", "/api/session", {})[1]["token"]
    found, reply = call(application, "POST", f"/api/session/{token}", {"index": 0, "choice": "A", **given})
    assert found == status, reply
    if status == 200 and "heard" in given:
        (row, *_) = analyse(test.folder).table.rows
        assert row["heard"] == min(given["heard"].values())


@pytest.mark.parametrize(
    ("page", "reason"),
    [
        (CHECK | {"right": 7}, "right is 7, there are 6 trials"),
        (CHECK | {"back": {"code": "{token}"}}, "{token} is not one of id"),
        (CHECK | {"back": {"address": "javascript:alert(1)"}}, "String should match"),
        (PAIRS | {"plays": 2, "loop": "region"}, "plays allows loop: off only"),
        (fakes.ALL[9] | {"switch": "restart"}, "switch: is not a known key"),
        (PAIRS | {"waveform": True}, "waveform: is not a known key"),
    ],
)
def test_pages_that_do_not_fit_are_one_line(tmp_path: Path, page: dict[str, Any], reason: str) -> None:
    from tonewood.workshop.batch.manifest import ManifestError

    with pytest.raises(ManifestError) as fault:
        made(tmp_path, [page, PAIRS])
    assert reason in str(fault.value)
