"""Which score leads a run: contacts, where there are enough of them."""

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.pr_auc import PR_AUC

from scenes.synthetic_run import description, write_trial

WITH_CONTACTS = (CONTACT_FORESIGHT, F1, PR_AUC)
OF_2_HZ = {"period_s": 0.5, "steps": 5}


def summary(folder, recordings, frames, scores=WITH_CONTACTS, headline="", every_s=1, **drawn):
    """The summary of two rows on recordings of 2 Hz; each forecast has contacts."""
    described = dict.fromkeys((f"seed-{i:02}" for i in range(recordings)), description(**OF_2_HZ))
    drawn |= {"frames": frames, "scores": scores, "every_s": every_s, **OF_2_HZ}
    trials = [
        write_trial(folder, label, name, skill, seed=i, **drawn)
        for i, name in enumerate(described)
        for label, skill in {"persistence": 0.4, "good": 0.8}.items()
    ]
    return summarise(described, trials, [], False, headline=headline)


def too_few(found):
    return [notice.text for notice in found.notices if "too few contacts" in notice.text]


def test_contacts_lead_where_twenty_units_have_one(tmp_path):
    found = summary(tmp_path, recordings=20, frames=2)
    assert found.headline == "contact_foresight.foreseen"
    assert not too_few(found)
    (difference,) = [one for one in found.differences if one.tracker == "good"]
    tests = {(test.stratum, test.horizon_s): test.verdict for test in difference.tests}
    assert tests == {(s, h): "better" for s in ("dynamic", "in-motion") for h in (0.5, 1.0, 2.0)}


def test_contacts_lead_where_fifty_forecasts_a_second_apart_have_one(tmp_path):
    assert summary(tmp_path / "long", recordings=1, frames=50).headline == "contact_foresight.foreseen"
    dense = summary(tmp_path / "dense", recordings=1, frames=49)
    assert dense.headline == "pr_auc.area", "without intervals no score with a threshold leads"
    (notice,) = too_few(dense)
    assert notice == (
        "too few contacts: 49 separate forecasts and 1 units have any, and 50 forecasts or 20 units are needed for"
        " Contact foresight to lead"
    )


def test_the_user_chooses_the_headline_score(tmp_path):
    assert summary(tmp_path, recordings=20, frames=2, headline="f1").headline == "f1.f1"


def test_a_headline_by_which_trackers_are_not_compared_is_refused(tmp_path):
    settings = CompareSettings(recordings=("none.mcap",), headline="brier", out=tmp_path / "run")
    with pytest.raises(ConfigurationError, match="--headline: trackers are not compared by 'brier'"):
        resolve(settings)


def test_where_nothing_is_scored_no_notice_counts_contacts(tmp_path):
    described = {"seed-00": description(**OF_2_HZ)}
    failed = write_trial(tmp_path, "good", "seed-00", 0.8, seed=0, frames=4, scored=2, scores=WITH_CONTACTS, **OF_2_HZ)
    assert not too_few(summarise(described, [failed], [], False))
