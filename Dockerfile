# docker build -t safe-ompl .
# docker run --rm -it -v "$PWD:/work" -v safe-ompl:/kernels safe-ompl plan panda_shelf --json result.json
FROM python:3.12-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
COPY pyproject.toml README.md LICENSE /src/
COPY .ci/machine_code.py /src/.ci/
COPY safe_ompl /src/safe_ompl
COPY scenarios /src/scenarios
RUN HATCH_BUILD_HOOK_ENABLE_CUSTOM=true pip wheel --no-cache-dir --no-deps --wheel-dir /dist /src

FROM python:3.12-slim
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*
RUN --mount=from=build,source=/dist,target=/dist pip install --no-cache-dir "$(echo /dist/*.whl)[plots,viewer,mcap]"
# The wheel holds their machine code; what a processor without AVX2 compiles is kept in this volume.
RUN useradd --create-home user && mkdir /kernels /work && chown user /kernels /work
ENV NUMBA_CACHE_DIR=/kernels
VOLUME /kernels
USER user
WORKDIR /work
ENTRYPOINT ["safe-ompl"]
CMD ["--help"]
