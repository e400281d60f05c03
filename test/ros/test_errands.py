"""Work off the executor's thread goes on whatever becomes of the executor."""

from types import SimpleNamespace

from rclpy.executors import SingleThreadedExecutor

from magcal_ros.ros.errands import Errands


def test_an_executor_that_is_shut_down_ends_no_work(graph):
    executor = SingleThreadedExecutor()
    executor.shutdown()
    errands, found = Errands(SimpleNamespace(executor=executor), "errands"), []
    for number in range(2):
        errands.run(lambda number=number: number, found.append, found.append)
        assert errands.finish_within(5.0)
        errands.deliver()
    assert found == [0, 1]
