#!/bin/bash
# As the official image's: root gives the server its folders, the configuration comes from the environment.
set -e
if [ "$(id -u)" = 0 ]; then
  chown -R zookeeper-server /conf /data /datalog
  exec setpriv --reuid zookeeper-server --regid zookeeper-server --init-groups "$0" "$@"
fi
cat >/conf/zoo.cfg <<CONF
dataDir=/data
dataLogDir=/datalog
clientPort=2181
tickTime=${ZOO_TICK_TIME:-2000}
initLimit=${ZOO_INIT_LIMIT:-5}
syncLimit=${ZOO_SYNC_LIMIT:-2}
maxClientCnxns=${ZOO_MAX_CLIENT_CNXNS:-60}
autopurge.purgeInterval=${ZOO_AUTOPURGE_PURGEINTERVAL:-0}
admin.enableServer=${ZOO_ADMINSERVER_ENABLED:-true}
4lw.commands.whitelist=${ZOO_4LW_COMMANDS_WHITELIST:-srvr}
CONF
jars=
for jar in zookeeper zookeeper-jute slf4j-api slf4j-simple metrics-core snappy-java netty-handler netty-common \
  netty-transport netty-buffer netty-codec netty-resolver netty-transport-native-epoll netty-transport-native-unix-common \
  commons-cli; do
  jars+=:/usr/share/java/$jar.jar
done
# shellcheck disable=SC2086
exec java $JVMFLAGS -Dzookeeper.jmx.log4j.disable=true -cp "${jars#:}" org.apache.zookeeper.server.quorum.QuorumPeerMain \
  /conf/zoo.cfg
