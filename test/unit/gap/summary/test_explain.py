"""What was weighed and why one may not be claimed, as the command prints it."""

import json

from stepdiag_ros.gap.constants import ALARM
from stepdiag_ros.gap.summary.explain import table


def test_every_set_keeps_its_evidence_and_says_whether_it_may_be_claimed(lost_motion):
    rows = lost_motion.weighed
    assert rows[0].names == ('backlash',) and not rows[0].refused
    assert rows[0].log_evidence == lost_motion.raw[0].log_bayes > ALARM
    refused = [row for row in rows if row.refused]
    assert refused and all(row.probability == 0.0 or row.log_evidence < ALARM for row in refused)
    assert sum(s.refused == '' for s in lost_motion.raw) >= 2


def test_the_table_names_forms_evidence_and_reasons(lost_motion):
    text = table(lost_motion.weighed)
    assert 'backlash' in text and 'not eligible: ' in text and 'log evidence' in text
    json.dumps([row.to_json_dict() for row in lost_motion.weighed], allow_nan=False)


def test_nothing_is_weighed_too(unaffected):
    rows = unaffected.weighed
    assert any(row.names == () and row.log_evidence == 0.0 for row in rows)
