"""The executor of this process."""

import pytest
from mi_ellipse.rendering.executor import LocalExecutor


def test_results_and_errors_come_through_futures():
    with LocalExecutor() as executor:
        future = executor.submit(divmod, 7, 2)
        assert future.done()
        assert future.result() == (3, 1)
        assert executor.submit(sorted, [1, 3, 2], reverse=True).result() == [3, 2, 1]
        assert isinstance(executor.submit(divmod, 7, 0).exception(), ZeroDivisionError)


def test_map_works_on_demand():
    made = []
    with LocalExecutor() as executor:
        results = executor.map(lambda a, b: made.append(a) or a * b, [1, 2, 3], [4, 5, 6])
        assert made == []
        assert next(results) == 4
        assert made == [1]
        assert list(results) == [10, 18]


def test_an_interrupt_is_no_result():
    def interrupted():
        raise KeyboardInterrupt

    with LocalExecutor() as executor, pytest.raises(KeyboardInterrupt):
        executor.submit(interrupted)


def test_nothing_runs_after_a_shutdown():
    executor = LocalExecutor()
    executor.shutdown()
    executor.shutdown(wait=False, cancel_futures=True)
    with pytest.raises(RuntimeError, match="shut down"):
        executor.submit(print)
