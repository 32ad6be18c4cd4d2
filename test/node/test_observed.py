"""Who watches knows which machines are there before these have said anything."""

from stepdiag_ros.nodes import environment

environment.prepare()

import rclpy  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402

from stepdiag_ros.nodes import base  # noqa: E402
from stepdiag_ros.nodes.observer import Observer  # noqa: E402


def test_a_sequencer_that_has_not_spoken_is_known_to_be_silent(ros_domain, eventually):
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('step_sequencer', namespace='/mute', context=context)
    says = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    try:
        with Observer(detail=False) as observer:
            eventually(lambda: observer.silent() == ['/mute/step_sequencer'])
            assert not observer.overview().machines

            def spoken():
                says.publish(DiagnosticArray(status=[DiagnosticStatus(name='mute/step_sequencer', message='ready')]))
                return not observer.silent()
            eventually(spoken)
            assert [machine.name for machine in observer.overview().machines] == ['/mute']
    finally:
        base.end(node, context)
