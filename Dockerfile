# The cluster's images, from source on Debian 12. `./dev cluster up` builds them; it needs BuildKit (DOCKER_BUILDKIT=1),
# which skips the stages that an image does not need.
#
#   runtime  the files of the Debian packages: daemons, driver host, CLI, plugins, their manual pages not; the user `iotcloud`; no
#            compiler, no headers, no shell tools but Debian's; what is in it: /usr/share/doc/iotcloud/sbom.cdx.json
#   bench    `runtime` with Python and the clients that `./dev cluster bench` runs

ARG BASE=debian:bookworm-slim
# Where the stage `build` compiles: a Debian 12, too.
ARG BUILD_BASE=${BASE}
# The source of the binaries: the stage below, or another image with the same folder /out.
ARG BINARIES=build

FROM ${BUILD_BASE} AS build
RUN apt-get update && apt-get install -y --no-install-recommends \
      g++ lld cmake ninja-build pkg-config \
      librabbitmq-dev librdkafka-dev libqpid-proton11-dev libzookeeper-mt-dev libthrift-dev thrift-compiler \
      libyaml-cpp-dev libsnappy-dev libboost-dev librocksdb-dev libhiredis-dev liblz4-dev libzstd-dev libspdlog-dev libfmt-dev libcli11-dev \
      prometheus-cpp-dev nlohmann-json3-dev libssl-dev zlib1g-dev libfreenect-dev libpng-dev libsystemd-dev libseccomp-dev libzip-dev \
      libmosquitto-dev libprotobuf-dev protobuf-compiler libmodbus-dev libudev-dev libpugixml-dev debhelper help2man python3 \
      libroscpp-dev libgeometry-msgs-dev libnav-msgs-dev libsensor-msgs-dev
WORKDIR /source
COPY . .
# The number of compilers at a time: each takes up to 1 GB. Empty: one for each core.
ARG JOBS
ARG PROGRAMS="iotcloud iotcloud-master iotcloud-gateway iotcloud-driver-host iotcloud-topology iotcloud-run iotcloud-recorder iotcloud-check iotcloud-robot \
  iotcloud-record can exec http loadgen mdns_finder modbus mqtt mqtt_finder onvif_finder replay ros serial sparkplug tcp turtle turtle_ros turtlebot_follower udp usb_finder"
ARG CLIENTS="bench_brokers_iotcloud bench_brokers_rabbitmq bench_brokers_kafka"
# Of the packages, whose sources here have no commits. Empty: that of CMakeLists.txt and CHANGELOG.md.
ARG VERSION
RUN cmake --preset release -DBUILD_TESTING=OFF -DIOTCLOUD_BENCHMARKS=ON \
 && ninja -C build/release ${JOBS:+-j ${JOBS}} ${PROGRAMS} ${CLIENTS} \
 && python3 development/package.py --out /out/packages --no-lint ${VERSION:+--version ${VERSION}} --components ${PROGRAMS} files \
 && for part in ${CLIENTS}; do \
      cmake --install build/release --strip --prefix /out --component ${part} || exit 1; \
    done

FROM ${BINARIES} AS binaries

# Debian's Thrift brings Qt and ICU, 60 MB that no program of this project uses. So only the linked libraries are
# copied, those that SASL loads, and those that component libraries with state link (topology/state): no program here does.
FROM ${BASE} AS libraries
RUN find /usr/lib/*-linux-gnu -maxdepth 1 -name '*.so*' | sort >/before && cp /var/lib/dpkg/status /base-status
RUN apt-get update && apt-get install -y --no-install-recommends \
      libboost-regex1.74.0 libfmt9 libfreenect0.5 libhiredis0.14 liblz4-1 libmodbus5 libmosquitto1 libpng16-16 libprotobuf-lite32 libpugixml1v5 libudev1 libprometheus-cpp-core1.0 libqpid-proton11 librabbitmq4 librdkafka1 \
      librocksdb7.8 librosconsole3d libroscpp4d libroscpp-serialization0d librostime1d libsasl2-modules libseccomp2 libsnappy1v5 \
      libspdlog1.10 libssl3 libstdc++6 libsystemd0 libthrift-0.17.0 libyaml-cpp0.7 libzookeeper-mt2 libzstd1 stunnel4 zlib1g
COPY --from=binaries /out /out
RUN for package in /out/packages/*.deb; do dpkg-deb --extract ${package} /unpacked || exit 1; done
RUN mkdir /needed && stores=$(ls /usr/lib/*-linux-gnu/librocksdb.so.7.8 /usr/lib/*-linux-gnu/libhiredis.so.0.14) \
 && { ldd /unpacked/usr/bin/* /unpacked/usr/lib/iotcloud/plugins/* /out/lib/iotcloud/bench/bench_* /usr/bin/stunnel4 ${stores} \
    | awk '/=> \// {sub("^/lib", "/usr/lib", $3); print $3}' && printf '%s\n' ${stores}; } | sort -u \
  | comm -23 - /before | xargs -r cp -L --parents -t /needed \
 && cp -r --parents /usr/lib/*-linux-gnu/sasl2 /usr/bin/stunnel4 /needed

# What is in the image, by what dpkg knows and what the packages say of themselves.
FROM libraries AS inventory
RUN apt-get update && apt-get install -y --no-install-recommends python3
COPY development/sbom.py /
RUN python3 /sbom.py image --name iotcloud --version "$(dpkg-deb --field /out/packages/iotcloud_*.deb Version)" \
      --own /out/packages --base /base-status --files /needed /sbom.cdx.json

FROM ${BASE} AS runtime
COPY --from=libraries /needed /
# `./dev cluster up` passes its caller's id, so that only that user can read the secrets' files.
ARG UID=10001
RUN groupadd --gid ${UID} iotcloud \
 && useradd --uid ${UID} --gid ${UID} --home-dir /var/lib/iotcloud --no-create-home --shell /usr/sbin/nologin iotcloud \
 && install -d -o iotcloud -g iotcloud -m 0750 /var/lib/iotcloud /var/lib/iotcloud-reports
COPY --from=libraries /unpacked/usr/bin /usr/bin
COPY --from=libraries /unpacked/usr/lib/iotcloud/plugins /usr/lib/iotcloud/plugins
COPY --from=inventory /sbom.cdx.json /usr/share/doc/iotcloud/sbom.cdx.json
COPY deploy/cluster/with-registry-tunnel /usr/bin/iotcloud-with-registry-tunnel
# Checks that every linked library exists.
RUN ldconfig \
 && ! ldd /usr/bin/iotcloud* /usr/bin/stunnel4 /usr/lib/iotcloud/plugins/* \
      /usr/lib/*-linux-gnu/librocksdb.so.7.8 /usr/lib/*-linux-gnu/libhiredis.so.0.14 | grep 'not found'
USER iotcloud
WORKDIR /var/lib/iotcloud

FROM runtime AS bench
USER root
RUN apt-get update && apt-get install -y --no-install-recommends python3 \
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/*
COPY --from=binaries /out/lib/iotcloud/bench /usr/lib/iotcloud/bench
COPY bench/figures.py bench/cluster_bench.py /usr/lib/iotcloud/bench/
RUN ! ldd /usr/lib/iotcloud/bench/bench_* | grep 'not found'
USER iotcloud
ENTRYPOINT ["/usr/bin/python3", "/usr/lib/iotcloud/bench/cluster_bench.py"]
