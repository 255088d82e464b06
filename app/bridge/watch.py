"""The cameras that a bridge watches, each in threads of its own, as its settings say."""

import threading
import time
from collections.abc import Callable, Collection, Sequence
from urllib.parse import SplitResult

from app.bridge import RefusedError, say
from app.bridge.bridge import Bridge
from app.bridge.home_assistant import HomeAssistant
from app.bridge.outbox import Outbox, deliver, forget_camera, known_cameras
from app.bridge.settings import Settings
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

    outbox: Outbox

    def __init__(
        self, settings: Settings, *, is_only: bool = False, before: "Watch | None" = None
    ) -> None:
        ((self._name, self._camera),) = settings.cameras.items()
        self.settings, self.refusal = settings, ""
        self.configuration = self._camera.configuration
        if before is not None and before.configuration and not self.configuration:
            self.configuration = {}  # What was said is taken back.
        self.stopping, self.closing = threading.Event(), threading.Event()
        receivers: dict[str, Sequence[Callable[..., None]]] = {}
        for number, address in enumerate(settings.webhook):
            receivers[f"webhook {number + 1}" if number else "webhook"] = [Webhook(address).send]
        self.home: HomeAssistant | None = None
        if settings.mqtt:
            host = settings.url.netloc.rpartition("@")[2]
            link = settings.url._replace(netloc=host).geturl()
            replay = self._client().replay
            self.home = HomeAssistant(settings.mqtt, self._name, self._camera.name, link, replay)
            receivers["mqtt"] = [self.home.send, self.home.keep]
        self._keeps = settings.queue, set(receivers)
        if before is not None and before._keeps == self._keeps:
            self.outbox = before.outbox
        else:
            self.outbox = Outbox(self._name, receivers, settings.queue)
        self.threads = [self._start(self._watch, is_only)]
        for name, calls in receivers.items():
            self.threads.append(self._start(deliver, self.outbox, self.closing, name, *calls))

    @property
    def is_watching(self) -> bool:
        """Whether frames may still be sent."""
        return self.threads[0].is_alive()

    @property
    def has_news(self) -> bool:
        """Whether something waits that a receiver may still take."""
        return bool(len(self.outbox) or (self.home and self.home.news()))

    def _start(self, target: Callable[..., None], *arguments: object) -> threading.Thread:
        thread = threading.Thread(target=target, args=arguments, name=self._name, daemon=True)
        thread.start()
        return thread

    def _client(self) -> Camera:
        """A connection to the service, for one thread."""
        key = self.settings.api_key.get_secret_value() if self.settings.api_key else None
        return Camera(self.settings.url, self._name, key, self.configuration)

    def _watch(self, is_only: bool) -> None:
        camera, client = self._camera, self._client()
        bridge = Bridge(client, self.outbox, self.home, ends_if_refused=is_only)
        source = Source(camera.source, camera.fps)
        while not self.stopping.is_set():
            try:
                bridge.watch(source, camera.fps, self.stopping)
                break
            except RefusedError as refusal:
                self.refusal = str(refusal)
                break
            except Exception as error:  # A fault of one camera shall not be one of all.
                say(f"a fault of this program: {type(error).__name__}: {error}")
                self.stopping.wait(_FAULT_WAIT_S)
        source.close()


class Cameras:
    """The cameras that the newest settings name; an only one is that of a command line."""

    def __init__(self, settings: Settings, *, is_only: bool) -> None:
        self._settings, self._is_only = settings, is_only
        self.watches: dict[str, Watch] = {}
        self._removing: set[tuple[SplitResult | None, str]] = set()
        self.apply(settings)

    @property
    def are_busy(self) -> bool:
        """Whether frames or events may still come."""
        watches = self.watches.values()
        return any(one.is_watching or (not one.refusal and len(one.outbox)) for one in watches)

    def apply(self, settings: Settings) -> None:
        """Watch as settings say; cameras of which they say the same as before go on.

        Those that are not named any more are removed from Home Assistant, also of an earlier start
        that had the same queue. Raises OSError, and changes nothing, if that cannot be used.
        """
        known = known_cameras(settings.queue) if settings.queue else set()
        self._settings = settings
        wanted = {name: settings.of(name) for name in settings.cameras}
        ended = {
            name: one for name, one in self.watches.items() if wanted.get(name) != one.settings
        }
        end(ended.values(), join_s=STOPS_WITHIN_S)
        for name in ended:
            del self.watches[name]
        for name in wanted.keys() - self.watches.keys():
            before = ended.get(name)
            self.watches[name] = Watch(wanted[name], is_only=self._is_only, before=before)
        earlier = {(one.settings.mqtt, name) for name, one in ended.items()}
        for one in earlier | {(settings.mqtt, name) for name in known}:
            if self._is_gone(*one) and one not in self._removing and not self._is_only:
                self._removing.add(one)
                threading.Thread(target=self._remove, args=one, name=one[1], daemon=True).start()

    def _remove(self, broker: SplitResult | None, name: str) -> None:
        """Withdraw a camera from Home Assistant unless it is watched again, and forget it."""
        if broker is not None:
            home = HomeAssistant(broker, name)
            home.withdraw()
            while self._is_gone(broker, name) and not home.is_gone:
                home.keep()
                time.sleep(POLL_S)
            home.close()
        if name not in self._settings.cameras and self._settings.queue:
            forget_camera(self._settings.queue, name)
        self._removing.discard((broker, name))
        say("the camera is removed")

    def _is_gone(self, broker: SplitResult | None, name: str) -> bool:
        return name not in self._settings.cameras or broker != self._settings.mqtt


def end(watches: Collection[Watch], signals: Sequence[int] = (), join_s: float = 0.0) -> None:
    """End the watching, and wait a while until all is delivered; a second signal ends that."""
    for one in watches:
        one.stopping.set()
    _wait(lambda: any(one.is_watching for one in watches), signals)
    homes = [one.home for one in watches if one.home]
    for home in homes:
        home.hide()
    _wait(lambda: any(one.has_news for one in watches), signals)
    for one in watches:
        one.closing.set()
    for home in homes:
        home.close()
    for thread in [thread for one in watches for thread in one.threads]:
        thread.join(join_s)


def _wait(goes_on: Callable[[], bool], signals: Sequence[int]) -> None:
    deadline = time.monotonic() + STOPS_WITHIN_S
    while time.monotonic() < deadline and len(signals) < 2 and goes_on():
        time.sleep(POLL_S)
