"""Send a log through the solver node's own function, or onto topics.

Without --live the messages go, in the order (stamp, machine, sequence), through the very
function that evaluates in the solver node, as fast as it can; the result has the same bits
as the live evaluation's and as that of `stepdiag evaluate BAG`.

With --live they are published on their topics, with /clock, at the pace of the log:

  stepdiag replay bags/demo
  stepdiag replay bags/demo --live --speed 10
"""

import argparse
import time

from stepdiag_ros.cli.progress import Bar
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.jsontext import to_json

NAME = 'replay'
HELP = "send a log through the solver node's own function, or onto topics"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")
    parser.add_argument('--json', action='store_true', help='print the evaluation as JSON')
    parser.add_argument('--live', action='store_true', help='publish on topics, with /clock')
    parser.add_argument('--speed', type=float, default=1.0, metavar='X',
                        help='with --live: times the pace of the log (default 1)')
    parser.add_argument('--into', metavar='NAMESPACE',
                        help="with --live: publish below this namespace (default: the log's)")
    parser.add_argument('--wait', type=float, default=10.0, metavar='S',
                        help='with --live: wait so long for somebody who listens (default 10)')


def run(args: argparse.Namespace) -> int:
    if args.live:
        return _live(args)
    from stepdiag_ros.cli.calibrate import summary
    from stepdiag_ros.estimate import evaluate
    from stepdiag_ros.nodes.replaying import assemble

    bar = Bar('replaying', quiet=args.json)
    assembler = assemble(args.bag, args.namespace, lambda done, total: bar.show(done, total))
    bar.close()
    document = evaluate(assembler.build()).to_json_dict()
    print(to_json(document) if args.json else summary(document))
    return 0 if document['status'] == 'ok' else 1


def _live(args: argparse.Namespace) -> int:
    if not args.speed > 0.0:
        raise StepdiagError(f'--speed is {args.speed:g}; give a number above 0')
    from stepdiag_ros.nodes.player import Player
    from stepdiag_ros.nodes.replaying import paced, read_messages

    namespace, messages = read_messages(args.bag, args.namespace)
    bar = Bar('replaying', quiet=args.json)
    with Player(namespace if args.into is None else '/' + args.into.strip('/')) as player:
        if not player.wait_for_listeners(args.wait):
            bar.say('nobody listens; playing all the same')
        began = time.monotonic()
        for done, (due_s, message) in enumerate(paced(messages, args.speed), 1):
            wait = began + due_s - time.monotonic()
            if wait > 0.0:
                bar.show(done, len(messages), message.topic)
                time.sleep(wait)
            player.play(message)
        bar.show(len(messages), len(messages))
        bar.close()
        delivered = player.settle()
    taken = time.monotonic() - began
    if args.json:
        print(to_json({'messages': len(messages), 'seconds': round(taken, 3),
                          'acknowledged': delivered}))
    else:
        print(f'{len(messages)} messages in {taken:.1f} s'
              + ('' if delivered else '; not all of them were acknowledged by their readers'))
    return 0
