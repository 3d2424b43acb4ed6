# Two stages: the first has compilers, tools and caches, the second only the finished virtual environment.
FROM docker.io/library/python:3.13-slim AS build
ENV PIP_NO_CACHE_DIR=1 UV_NO_CACHE=1 UV_LINK_MODE=copy UV_COMPILE_BYTECODE=1
RUN python3 -m venv /opt/build && /opt/build/bin/pip install uv==0.13.9 cyclonedx-bom==7.5.0 \
    && python3 -m venv --without-pip /opt/steradian
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY driver driver
RUN /opt/build/bin/uv pip install --python /opt/steradian/bin/python -c constraints.txt -r pyproject.toml \
        --extra export --extra store \
    && find /opt/steradian/lib -depth \( -type d -name tests -o -name '*.pyi' -o -name '*.h' -o -name '*.hpp' \) \
        -exec rm -rf {} +
COPY service service
RUN /opt/build/bin/uv pip install --python /opt/steradian/bin/python --no-deps .
COPY container /opt/steradian/container
RUN /opt/steradian/container/kernels \
    && /opt/build/bin/cyclonedx-py environment --output-reproducible -o /opt/steradian/sbom.cdx.json /opt/steradian/bin/python

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
# The base image comes without the standard library's bytecode, which nobody can write once the root is read-only.
RUN mkdir /data && chown 10001:10001 /data \
    && python3 -m compileall -q -x '/(site|dist)-packages/|/test/' "$(python3 -c 'import os; print(os.path.dirname(os.__file__))')"
USER 10001:10001
VOLUME /data
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=30s \
    CMD ["/opt/steradian/container/health"]
ENTRYPOINT ["/opt/steradian/container/start"]
CMD ["steradian", "serve"]
