"""A silent sequencer is called silent, one that was replaced is called so, and who waits asks without waiting."""

import time
from types import SimpleNamespace

import pytest
from action_msgs.msg import GoalStatus
from rclpy.task import Future

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.nodes import sent_goal
from stepdiag_ros.nodes.sent_goal import LostGoal, SentGoal, silence_words


class Server:
    """Whoever has the goal: requests wait until it answers them."""

    def __init__(self):
        self.waiting: list[Future] = []

    def ask(self, answered) -> None:
        self.waiting.append(Future())
        self.waiting[-1].add_done_callback(answered)

    def answer(self, status: int) -> None:
        for future in self.waiting:
            future.set_result(SimpleNamespace(status=status))
        self.waiting.clear()


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr(sent_goal, 'DOUBT_S', 0.05)
    monkeypatch.setattr(sent_goal, 'ASK_S', 0.02)
    monkeypatch.setattr(sent_goal, 'SILENT_S', 0.1)
    return Server()


def test_one_that_is_silent_is_asked_and_keeps_its_goal(server):
    goal = SentGoal('/m/step_sequencer', server.ask)
    goal.look()
    assert len(server.waiting) == 1      # as long as there is no doubt, one request is enough
    time.sleep(0.2)
    goal.look()
    assert len(server.waiting) == 2 and not goal.result.done()
    goal.spoke(time.monotonic())
    assert len(goal.silences) == 1 and 'silent for 0 s' in silence_words(goal.silences)
    server.answer(GoalStatus.STATUS_SUCCEEDED)
    assert goal.result.result().status == GoalStatus.STATUS_SUCCEEDED
    goal.look()


def test_only_an_answer_that_does_not_know_the_goal_says_that_it_is_lost(server):
    goal = SentGoal('/m/step_sequencer', server.ask)
    server.waiting.clear()               # it died with the first request
    time.sleep(0.1)
    goal.look()
    server.answer(GoalStatus.STATUS_UNKNOWN)
    with pytest.raises(LostGoal, match='/m/step_sequencer has ended, and the one that runs now'):
        goal.look()


def test_silence_ends_some_time_and_is_called_silence(server, monkeypatch):
    monkeypatch.setattr(sent_goal, 'GIVE_UP_S', 0.1)
    goal = SentGoal('/m/step_sequencer', server.ask)
    time.sleep(0.15)
    with pytest.raises(StepdiagError, match='has been silent for 0 s') as caught:
        goal.look()
    assert not isinstance(caught.value, LostGoal)
