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
