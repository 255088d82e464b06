"""The cameras that a bridge watches, each in threads of its own, as its settings say."""

import threading
import time
from collections.abc import Callable, Collection, Sequence
from urllib.parse import SplitResult

from app.bridge import RefusedError, say
from app.bridge.bridge import Bridge
from app.bridge.home_assistant import HomeAssistant
from app.bridge.outbox import Outbox, deliver, forget_camera, known_cameras
from app.bridge.settings import Settings, SettingsError
from app.bridge.source import Source
from app.bridge.web import Camera, Webhook

STOPS_WITHIN_S = 5.0
POLL_S = 0.1
_FAULT_WAIT_S = 10.0


class Watch:
    """A camera's frames to the service, its events to their receivers, until this is ended.

    ``settings`` are those of this camera alone, and ``before`` has watched it until now. An only
    camera ends where the service refuses it; among others, it is tried again.
    """

    def __init__(
        self, settings: Settings, *, is_only: bool = False, before: "Watch | None" = None
    ) -> None:
        ((self.camera_id, self._camera),) = settings.cameras.items()
        self.settings, self._is_only = settings, is_only
        self.refusal: RefusedError | None = None
        self.configuration = self._camera.configuration
        if self.configuration is None and before is not None and before.configuration is not None:
            self.configuration = {}  # What was said is taken back.
        self._stopping, self._closing = threading.Event(), threading.Event()
        receivers: dict[str, Sequence[Callable[..., None]]] = {}
        for number, address in enumerate(settings.webhook):
            receivers[f"webhook {number + 1}" if number else "webhook"] = [Webhook(address).send]
        self._home_assistant: HomeAssistant | None = None
        if settings.mqtt:
            home = HomeAssistant(settings.mqtt, self.camera_id, self._camera.name)
            self._home_assistant, receivers["mqtt"] = home, [home.send, home.keep]
        self._keeps = settings.queue, set(receivers)
        same = before is not None and before._keeps == self._keeps
        self.outbox: Outbox = (
            before.outbox
            if before is not None and same
            else Outbox(self.camera_id, receivers, settings.queue)
        )
        self._threads = [self._start(self._watch)]
        for name, calls in receivers.items():
            self._threads.append(self._start(deliver, self.outbox, self._closing, name, *calls))

    @property
    def is_watching(self) -> bool:
        """Whether frames may still be sent."""
        return self._threads[0].is_alive()

    @property
    def has_news(self) -> bool:
        """Whether something waits that a receiver may still take."""
        return bool(len(self.outbox) or (self._home_assistant and self._home_assistant.news()))

    def stop(self) -> None:
        """Send no more frames."""
        self._stopping.set()

    def hide(self) -> None:
        """Show that the camera is offline."""
        if self._home_assistant:
            self._home_assistant.hide()

    def close(self, join_s: float = 0.0) -> None:
        """Deliver no more."""
        self._closing.set()
        if self._home_assistant:
            self._home_assistant.close()
        for thread in self._threads:
            thread.join(join_s)

    def _start(self, target: Callable[..., None], *arguments: object) -> threading.Thread:
        thread = threading.Thread(target=target, args=arguments, name=self.camera_id, daemon=True)
        thread.start()
        return thread

    def _watch(self) -> None:
        settings, camera = self.settings, self._camera
        key = settings.api_key.get_secret_value() if settings.api_key else None
        client = Camera(settings.url, self.camera_id, key, self.configuration)
        bridge = Bridge(client, self.outbox, self._home_assistant, ends_if_refused=self._is_only)
        source = Source(camera.source, camera.fps)
        try:
            while not self._stopping.is_set():
                try:
                    return bridge.watch(source, camera.fps, self._stopping)
                except RefusedError as refusal:
                    self.refusal = refusal
                    return
                except Exception as error:  # A fault of one camera shall not be one of all.
                    say(f"a fault of this program: {type(error).__name__}: {error}")
                    self._stopping.wait(_FAULT_WAIT_S)
        finally:
            source.close()


class Cameras:
    """The cameras that the newest settings name; an only one is that of a command line."""

    def __init__(self, settings: Settings, *, is_only: bool) -> None:
        self._settings, self._is_only = settings, is_only
        self._watches: dict[str, Watch] = {}
        self._removing: set[tuple[SplitResult | None, str]] = set()
        self.apply(settings)

    @property
    def watches(self) -> list[Watch]:
        """What watches them."""
        return list(self._watches.values())

    @property
    def are_busy(self) -> bool:
        """Whether frames or events may still come."""
        return any(one.is_watching or (not one.refusal and len(one.outbox)) for one in self.watches)

    def apply(self, settings: Settings) -> None:
        """Watch as settings say; cameras of which they say the same as before go on.

        Those that are not named any more are removed from Home Assistant, also of an earlier start
        that had the same queue. Raises SettingsError, and changes nothing, if that cannot be used.
        """
        try:
            known = known_cameras(settings.queue) if settings.queue else set()
        except OSError as error:
            raise SettingsError(str(error)) from None
        self._settings = settings
        wanted = {name: settings.of(name) for name in settings.cameras}
        ended = {
            name: one for name, one in self._watches.items() if wanted.get(name) != one.settings
        }
        end(ended.values(), join_s=STOPS_WITHIN_S)
        for name in ended:
            del self._watches[name]
        for name in wanted.keys() - self._watches.keys():
            before = ended.get(name)
            self._watches[name] = Watch(wanted[name], is_only=self._is_only, before=before)
        earlier = {(one.settings.mqtt, name) for name, one in ended.items()}
        for one in earlier | {(settings.mqtt, name) for name in known}:
            if self._is_gone(*one) and one not in self._removing and not self._is_only:
                self._removing.add(one)
                threading.Thread(target=self._remove, args=one, name=one[1], daemon=True).start()

    def _remove(self, broker: SplitResult | None, camera_id: str) -> None:
        """Withdraw a camera from Home Assistant unless it is watched again, and forget it."""
        if broker is not None:
            home = HomeAssistant(broker, camera_id)
            home.withdraw()
            while self._is_gone(broker, camera_id) and not home.is_gone:
                home.keep()
                time.sleep(POLL_S)
            home.close()
        if camera_id not in self._settings.cameras and self._settings.queue:
            forget_camera(self._settings.queue, camera_id)
        self._removing.discard((broker, camera_id))
        say("the camera is removed")

    def _is_gone(self, broker: SplitResult | None, camera_id: str) -> bool:
        return camera_id not in self._settings.cameras or broker != self._settings.mqtt


def end(watches: Collection[Watch], signals: Sequence[int] = (), join_s: float = 0.0) -> None:
    """End the watching, and wait a while until all is delivered; a second signal ends that."""
    for one in watches:
        one.stop()
    _wait(lambda: any(one.is_watching for one in watches), signals)
    for one in watches:
        one.hide()
    _wait(lambda: any(one.has_news for one in watches), signals)
    for one in watches:
        one.close(join_s)


def _wait(goes_on: Callable[[], bool], signals: Sequence[int]) -> None:
    deadline = time.monotonic() + STOPS_WITHIN_S
    while time.monotonic() < deadline and len(signals) < 2 and goes_on():
        time.sleep(POLL_S)
