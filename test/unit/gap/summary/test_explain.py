"""What was weighed and why one may not be claimed, as the command prints it."""

import json

import pytest

from stepdiag_ros.effects import effect_class
from stepdiag_ros.gap.constants import ALARM
from stepdiag_ros.gap.summary.explain import table


@pytest.fixture(scope='module')
def found(case):
    return case.diagnose(effect_class('backlash')(B=[4e-6, 0.0, 3e-6]))


def test_every_set_keeps_its_evidence_and_says_whether_it_may_be_claimed(found):
    rows = found.weighed
    assert rows[0].names == ('backlash',) and not rows[0].refused
    assert rows[0].log_evidence == found.raw[0].log_bayes > ALARM
    refused = [row for row in rows if row.refused]
    assert refused and all(row.probability == 0.0 or row.log_evidence < ALARM for row in refused)
    assert sum(s.refused == '' for s in found.raw) >= 2


def test_the_table_names_forms_evidence_and_reasons(found):
    text = table(found.weighed)
    assert 'backlash' in text and 'not eligible: ' in text and 'log evidence' in text
    json.dumps([row.to_json_dict() for row in found.weighed], allow_nan=False)


def test_nothing_is_weighed_too(case):
    rows = case.diagnose().weighed
    assert any(row.names == () and row.log_evidence == 0.0 for row in rows)
