# One image for every service; docker-compose.yml says which one a container runs.
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
WORKDIR /app
COPY pyproject.toml README.md LICENSE ./
COPY schemas schemas
COPY services services
COPY plugins plugins
COPY bench bench
COPY scenes scenes
COPY deploy deploy
RUN pip install --no-cache-dir --require-hashes -r deploy/requirements.txt && pip install --no-cache-dir --no-deps .
# Any user may be given to run as: who may read the files with the keys.
RUN useradd --create-home --uid 1000 nuno && mkdir --mode 1777 /recordings
ENV XDG_CACHE_HOME=/tmp/cache
WORKDIR /tmp
USER nuno
VOLUME /recordings
ENTRYPOINT ["nuno"]
