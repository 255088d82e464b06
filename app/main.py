"""The application: its assembly, start and shutdown."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial

import anyio
from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from fastapi.middleware.gzip import GZipMiddleware
from starlette.types import Scope

from app import VERSION
from app.camera import CameraSession
from app.cameras import CameraSessions, SessionLimits
from app.decoding.pictures import Workers
from app.http.access_log import AccessLogMiddleware
from app.http.admission import AdmissionMiddleware, UploadLimits
from app.http.errors import register_error_handlers
from app.http.identity import CAMERA_HEADER, Identity
from app.http.metrics import Metrics
from app.http.routing import RouteTable, answering_head
from app.photograph import Estimator
from app.routes import cameras, deepstack, index, pose, sequence, system
from app.routes.cameras import SESSION_HEADER
from app.routes.openapi import SERVERS, TAGS, add_openapi
from app.scheduling.executor import Executor
from app.scheduling.process import configure_process, trim_heap
from app.serving import Runtime, become_ready, keep_index_loaded, read_cameras
from app.settings import Settings, read_settings
from app.vision.images import configure_pillow
from index.store import PoseIndex

MAX_JSON_BYTES = 256_000  # The largest configuration of a camera that is accepted has 57 kB.

DESCRIPTION = """
3D human pose from one camera frame on a plain CPU: silhouettes, Krawtchouk moments and
exact nearest neighbours among simulated silhouettes.

**Pixels**: origin at the centre of the top-left pixel, x right, y down, in the frame after
its EXIF orientation is applied. **3D**: metres, camera axes (x right, y down, z forward),
origin at the pelvis. **Normalised frame**: the 128x48 (height x width) silhouette image in
which descriptors and reprojection errors are measured.

Errors are `application/problem+json` (RFC 9457).
"""


def create_app(
    settings: Settings | None = None,
    estimator: Estimator | None = None,
    read_index: Callable[[], PoseIndex] | None = None,
) -> FastAPI:
    """Assemble the service.

    By default, settings are read from the environment, and the estimator is loaded while the
    service already answers probes; ``read_index`` returns its index instead of their folder.
    """
    settings = settings or read_settings()
    executor = Executor(settings.concurrency, settings.max_wait_s, settings.request_timeout_s)
    metrics = Metrics(settings.request_timeout_s)
    memory_bytes = settings.camera_memory_mb * 1024**2
    limits = SessionLimits(settings.max_cameras, settings.camera_idle_s, memory_bytes)
    configured = read_cameras(settings.cameras_file)
    sessions = CameraSessions(CameraSession, limits, configured, metrics.observe_session)
    workers = Workers(settings.concurrency, settings.max_upload_bytes, settings.max_pixels)
    runtime = Runtime(settings, executor, workers, metrics, sessions)
    metrics.sessions.set_function(lambda: len(sessions))
    metrics.observe_cameras(sessions.traffic)
    metrics.sequences.set_function(lambda: len(runtime.sequences))
    metrics.in_flight.set_function(lambda: executor.queue.in_flight)
    metrics.capacity_used.set_function(executor.queue.load)
    metrics.observe_build(VERSION, settings)
    if estimator is not None:
        become_ready(runtime, estimator)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        configure_process()
        configure_pillow()
        async with anyio.create_task_group() as tasks:
            if runtime.estimator is None:
                tasks.start_soon(keep_index_loaded, runtime, read_index)
                # Until then, connections are left to other processes, which may be ready.
                if settings.workers > 1:
                    await runtime.attempted.wait()
            tasks.start_soon(_tidy_up, runtime)
            yield
            tasks.cancel_scope.cancel()
        executor.shut_down()
        workers.close()

    app = FastAPI(
        title="Silhouette pose",
        version=VERSION,
        description=DESCRIPTION,
        summary="3D human pose from one camera frame, on a plain CPU.",
        contact={"name": "The silhouette-pose authors"},
        openapi_tags=TAGS,
        servers=SERVERS,
        license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # app/http/access_log.py drops the slash instead.
    )
    app.state.runtime, app.state.api_keys = runtime, settings.api_keys
    routers = [module.router for module in (pose, cameras, sequence, index, deepstack, system)]
    for router in routers:
        app.include_router(router)
    add_openapi(app)
    system.add_pages(app)
    table = RouteTable(route for router in (*routers, app.router) for route in router.routes)
    register_error_handlers(app, table)
    _add_middleware(app, runtime, table)
    return app


def _add_middleware(app: FastAPI, runtime: Runtime, table: RouteTable) -> None:
    settings, queue = runtime.settings, runtime.executor.queue
    configurations = UploadLimits(
        MAX_JSON_BYTES, settings.upload_timeout_s, MAX_JSON_BYTES * settings.max_requests
    )
    frames = UploadLimits(
        settings.max_upload_bytes,
        settings.upload_timeout_s,
        # Frames of 4 MB from 32 cameras at once.
        max(128 * 1024**2, 2 * settings.max_upload_bytes),
    )
    videos = UploadLimits(
        settings.max_video_bytes,
        settings.video_upload_timeout_s,
        settings.max_sequences * settings.max_video_bytes,
    )

    def limits_of(scope: Scope) -> UploadLimits:
        if scope["method"] != "POST":
            return configurations
        return videos if scope["path"] == sequence.PATH else frames

    def check(scope: Scope, identity: Identity) -> None:
        # Frames of a video wait until there is room for them.
        if scope["method"] == "POST" and scope["path"] != sequence.PATH:
            queue.check(identity.caller, identity.stream)

    # Compressing a smaller answer saves less than a packet; an answer with seven hypotheses shrinks
    # to a quarter in half a millisecond, and a higher level takes longer.
    app.add_middleware(GZipMiddleware, minimum_size=1400, compresslevel=1)
    app.add_middleware(
        AdmissionMiddleware,
        check=check,
        limits_of=limits_of,
        max_open=settings.max_requests,
        origins=settings.cors_origins,
    )
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(settings.cors_origins),
            allow_methods=list(table.methods),
            allow_headers=["X-API-Key", "Authorization", "X-Request-ID", CAMERA_HEADER],
            expose_headers=["Retry-After", "X-Request-ID", SESSION_HEADER],
        )
    app.add_middleware(answering_head)
    # This middleware is the outermost, so that it also sees refused requests.
    app.add_middleware(
        AccessLogMiddleware,
        metrics=runtime.metrics,
        table=table,
        on_refused=partial(cameras.count_dropped, runtime.sessions),
    )


async def _tidy_up(runtime: Runtime) -> None:
    while True:
        await anyio.sleep(min(runtime.settings.camera_idle_s, 10.0))
        runtime.sessions.end_idle()
        # Frames leave 30 MB, of which the next one needs a part: getting that back from the system
        # takes as long as a tenth of its work, too long after every frame.
        runtime.executor.submit(trim_heap)
