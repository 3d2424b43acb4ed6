# Two stages: the first has compilers and caches, the second only the finished virtual environment.
FROM docker.io/library/python:3.13-slim AS build
ENV PIP_NO_CACHE_DIR=1 UV_NO_CACHE=1 UV_LINK_MODE=copy
RUN python3 -m venv /opt/build && /opt/build/bin/pip install uv==0.13.9 && python3 -m venv /opt/steradian
WORKDIR /src
COPY pyproject.toml constraints.txt ./
COPY driver driver
RUN /opt/build/bin/uv pip install --python /opt/steradian/bin/python -c constraints.txt -r pyproject.toml --extra export
COPY README.md LICENSE ./
COPY service service
RUN /opt/build/bin/uv pip install --python /opt/steradian/bin/python --no-deps .

FROM docker.io/library/python:3.13-slim
LABEL org.opencontainers.image.title="Steradian" org.opencontainers.image.licenses="Apache-2.0"
COPY --from=build /opt/steradian /opt/steradian
ENV PATH=/opt/steradian/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    STERADIAN_DATA=/data \
    STERADIAN_HOST=0.0.0.0 \
    STERADIAN_KEY_FILE=/data/admin.key \
    NUMBA_CACHE_DIR=/data/cache/numba \
    MPLCONFIGDIR=/tmp/matplotlib
RUN mkdir /data && chown 10001:10001 /data
USER 10001:10001
VOLUME /data
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s \
    CMD ["python3", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8000/healthz', timeout=2)"]
CMD ["steradian", "serve"]
