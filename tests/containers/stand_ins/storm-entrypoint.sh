#!/bin/bash
# As the official image's: what is not said otherwise comes from a file that is made when it is missing.
set -e
if [ ! -e "$STORM_CONF_DIR/storm.yaml" ]; then
  cat >"$STORM_CONF_DIR/storm.yaml" <<CONF
storm.zookeeper.servers: [zookeeper]
nimbus.seeds: [nimbus]
storm.log.dir: "$STORM_LOG_DIR"
storm.local.dir: "$STORM_DATA_DIR"
CONF
fi
exec "$@"
