# docker build -t safe-ompl .
# docker run --rm -it -v "$PWD:/work" safe-ompl plan panda_shelf --json result.json
FROM python:3.12-slim AS build
COPY pyproject.toml setup.py build_backend.py README.md LICENSE /src/
COPY safe_ompl /src/safe_ompl
COPY scenarios /src/scenarios
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /dist /src

FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
RUN --mount=from=build,source=/dist,target=/dist pip install --no-cache-dir "$(echo /dist/*.whl)[plots,viewer,mcap]"
RUN useradd --create-home user && mkdir /work && chown user /work
USER user
WORKDIR /work
ENTRYPOINT ["safe-ompl"]
CMD ["--help"]
