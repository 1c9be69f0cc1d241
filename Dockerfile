# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

# The localizer with compiled kernels, on ROS 2 Jazzy:
#   docker build -t dg_localization .
#   docker run --rm --net=host -v $PWD:/data dg_localization \
#       ros2 run dg_localization localizer --ros-args --params-file /data/my_fleet.yaml
FROM ros:jazzy-ros-base

SHELL ["/bin/bash", "-o", "pipefail", "-c"]

# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-venv \
    && rm -rf /var/lib/apt/lists/*

# The processor that runs the image may lack instructions of the one that builds it.
ENV NUMBA_CPU_NAME=generic \
    NUMBA_CACHE_DIR=/opt/dg_localization/kernels \
    VIRTUAL_ENV=/opt/dg_localization/venv \
    PATH=/opt/dg_localization/venv/bin:$PATH

WORKDIR /opt/dg_localization
# Hashed versions of what ROS and Ubuntu lack; numpy is that of Ubuntu.
COPY requirements/build.txt requirements/jazzy.txt src/dg_localization/requirements/
RUN python3 -m venv --system-site-packages venv \
    && pip install --no-cache-dir --require-hashes --no-deps \
        -r src/dg_localization/requirements/build.txt \
    && pip install --no-cache-dir --require-hashes --no-deps --no-build-isolation \
        -r src/dg_localization/requirements/jazzy.txt

COPY . src/dg_localization
RUN . /opt/ros/jazzy/setup.bash \
    && colcon build --base-paths src \
    && . install/setup.bash \
    && ros2 run dg_localization compile_kernels

ENTRYPOINT ["/bin/bash", "-c", ". /opt/dg_localization/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "dg_localization", "localizer", "--help"]
