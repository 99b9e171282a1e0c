# The package with its .venv, messages and compiled kernels; ROS 2 Jazzy comes from wheels. Not built yet where it was
# written: no container engine there.
#   docker build -t fracture_collision . && docker run --rm -it --network host fracture_collision make play
FROM ubuntu:24.04
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
       ca-certificates cmake g++ make python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home user
USER user
WORKDIR /home/user/fracture_collision
COPY --chown=user . .
RUN make build
CMD ["make", "smash"]
