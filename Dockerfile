# One image for every service; docker-compose.yml says which one a container runs.
FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
WORKDIR /app
COPY pyproject.toml README.md LICENSE ./
COPY schemas schemas
COPY services services
COPY plugins plugins
COPY scenes scenes
RUN pip install --no-cache-dir ".[view]"
RUN useradd --create-home nuno && mkdir /recordings && chown nuno /recordings
USER nuno
VOLUME /recordings
ENTRYPOINT ["nuno"]
