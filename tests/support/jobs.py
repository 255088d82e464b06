"""Jobs that end early."""

from app.scheduling.job import DeadlineError, Job


class ShortJob(Job):
    """A job whose deadline passes at one of its checkpoints, and which then goes on.

    Parameters
    ----------
    steps : int
        Checkpoints that it passes before.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.steps = steps

    def checkpoint(self) -> None:
        self.steps -= 1
        if self.steps == -1:
            raise DeadlineError("too late")


class LateJob(Job):
    """A job whose time is nearly over after a number of questions whether it is."""

    def __init__(self, in_time: int) -> None:
        super().__init__()
        self.in_time = in_time

    def is_late(self, share: float) -> bool:
        assert 0 < share < 1
        self.in_time -= 1
        return self.some_suffice and self.in_time < 0
