"""A real ROS 2 node with services and actions, which does as it is told, like the one of `sfglab.lab.ros2`."""

import sys
import threading
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import topic_peer
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci
from topic_peer import rclpy_peer, report


def list_of(value):
    return value if isinstance(value, (bool, int, float, str)) else list(value)


class Peer(topic_peer.Peer):
    executor_type = MultiThreadedExecutor

    def __init__(self, name):
        super().__init__(name)
        self.group, self.clients = ReentrantCallbackGroup(), {}

    def serve(self, service):
        """Answer with the data that were asked with, and report every request."""

        def answer(request, response):
            report("asked", data=request.data)
            response.success = request.data
            return response

        self.kept.append(self.node.create_service(SetBool, service, answer))
        report("serving")

    def call(self, service, times, timeout_s):
        """Call one time after another, the data alternating; report the answers and their times [s]."""
        deep = QoSProfile(
            depth=1000
        )  # ten replies to others push this client's reply out of a stalled reader
        client = self.clients.get(service) or self.node.create_client(
            SetBool, service, qos_profile=deep
        )
        self.clients[service], answers, took_s = client, [], []
        ready = client.wait_for_service(timeout_s)
        for n in range(times if ready else 0):
            start_s, done = time.perf_counter(), threading.Event()
            future = client.call_async(SetBool.Request(data=n % 2 == 1))
            future.add_done_callback(lambda _, done=done: done.set())
            answered = done.wait(timeout_s)
            took_s.append(time.perf_counter() - start_s)
            answers.append(future.result().success if answered else None)
        report("called", ready=ready, answers=answers, took_s=took_s)

    def parameters(self, node):
        """Report what it reads of a node's parameters, as `ros2 param` does."""
        client = AsyncParameterClient(self.node, node)
        assert client.wait_for_services(30.0)
        names = sorted(self.outcome(client.list_parameters([], 0)).result.names)
        got = self.outcome(client.get_parameters(names)).values
        values = [parameter_value_to_python(one) for one in got]
        assert list(self.outcome(client.get_parameter_types(names)).types) == [
            one.type for one in got
        ]
        described = self.outcome(client.describe_parameters(names)).descriptors
        refused = self.outcome(client.set_parameters([Parameter(names[0], value="other")])).results[
            0
        ]
        report(
            "parameters",
            values=dict(zip(names, map(list_of, values), strict=True)),
            read_only=all(one.read_only for one in described),
            why=refused.reason if not refused.successful else "",
        )

    def perform(self, action):
        """Count Fibonacci's numbers, a feedback for each."""

        def execute(goal):
            feedback = Fibonacci.Feedback(sequence=[0, 1])
            for _ in range(goal.request.order):
                if goal.is_cancel_requested:
                    goal.canceled()
                    return Fibonacci.Result(sequence=feedback.sequence)
                feedback.sequence = [*feedback.sequence, sum(feedback.sequence[-2:])]
                goal.publish_feedback(feedback)
                time.sleep(0.02)
            goal.succeed()
            return Fibonacci.Result(sequence=feedback.sequence)

        options = {"callback_group": self.group, "cancel_callback": lambda _: CancelResponse.ACCEPT}
        self.kept.append(ActionServer(self.node, Fibonacci, action, execute, **options))
        report("performing")

    def act(self, action, order, cancel):
        """Ask for numbers; report what came. It cancels after the first feedback, or not."""
        if action not in self.clients:
            self.clients[action] = ActionClient(
                self.node, Fibonacci, action, callback_group=self.group
            )
        client, feedbacks, begun = self.clients[action], [], threading.Event()

        def hear(message):
            feedbacks.append(list(message.feedback.sequence))
            begun.set()

        assert client.wait_for_server(30.0)
        goal = self.outcome(
            client.send_goal_async(Fibonacci.Goal(order=order), feedback_callback=hear)
        )
        if cancel:
            assert begun.wait(30.0)
            self.outcome(goal.cancel_goal_async())
        ended = self.outcome(goal.get_result_async())
        report(
            "acted", status=ended.status, numbers=list(ended.result.sequence), feedbacks=feedbacks
        )

    def outcome(self, future):
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(30.0)
        return future.result()


if __name__ == "__main__":
    rclpy_peer.main(Peer)
