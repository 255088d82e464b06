# syntax=docker/dockerfile:1
# Two stages: the first has pip, the second only serves. Networks, index and page are in the package.

FROM python:3.11-slim AS build
# milvus, for an index in Milvus; nothing by default.
ARG EXTRAS=
WORKDIR /src
RUN python -m venv /srv/.venv
COPY LICENSE LICENSE
COPY NOTICE NOTICE
COPY pyproject.toml ./
COPY README.md README.md
COPY constraints.txt constraints.txt
COPY app app
COPY descriptor descriptor
COPY index index
RUN /srv/.venv/bin/pip install --no-cache-dir -c constraints.txt ".${EXTRAS:+[$EXTRAS]}"

FROM python:3.11-slim
ARG REVISION=unknown
LABEL org.opencontainers.image.title="silhouette-pose" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.revision="${REVISION}"
# The service writes nothing at run time: the root may be read-only, uploads stay in memory.
ENV HOST=0.0.0.0 \
    PORT=8000 \
    POSE_REVISION="${REVISION}" \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1
COPY --from=build /srv/.venv /srv/.venv
WORKDIR /srv
# For the queue of the bridge, which compose.yaml runs from the same image.
RUN install --directory --owner=10001 --group=10001 /queue
USER 10001:10001
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=2s --start-period=10s \
  CMD ["/srv/.venv/bin/python", "-c", "import os, urllib.request; urllib.request.urlopen(f\"http://127.0.0.1:{os.environ['PORT']}/readyz\", timeout=2)"]
STOPSIGNAL SIGTERM
CMD ["/srv/.venv/bin/python", "-m", "app"]
