#!/bin/bash
# As the official image's.
read -ra options <<<"$KAFKA_HEAP_OPTS $KAFKA_OPTS"
exec java "${options[@]}" -XX:+UseSerialGC -XX:TieredStopAtLevel=1 -cp '/opt/kafka/libs/*' kafka.admin.ConfigCommand "$@"
