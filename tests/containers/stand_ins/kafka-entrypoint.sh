#!/bin/bash
# As apache/kafka's: KAFKA_SOME_KEY is the setting some.key; the folder is formatted when it is empty.
set -e
config=/etc/kafka/server.properties
env | grep '^KAFKA_' | grep -v '^KAFKA_HEAP_OPTS=' | while IFS='=' read -r name value; do
  name=${name#KAFKA_}
  name=${name//_/.}
  echo "${name,,}=$value"
done >$config
read -ra heap <<<"$KAFKA_HEAP_OPTS"
kafka=(java "${heap[@]}" -XX:+UseSerialGC -cp '/opt/kafka/libs/*')
"${kafka[@]}" kafka.tools.StorageTool format --ignore-formatted --config $config --cluster-id "$CLUSTER_ID"
exec "${kafka[@]}" kafka.Kafka $config
