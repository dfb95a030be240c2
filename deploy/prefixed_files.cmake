# What deploy/CMakeLists.txt installs with paths that follow the prefix.
file(GLOB units RELATIVE "${PREFIXED_SOURCE}" "${PREFIXED_SOURCE}/deploy/systemd/*.service" "${PREFIXED_SOURCE}/deploy/systemd/*.socket")
foreach(unit ${units})
  install_prefixed(${unit} lib/systemd/system)
endforeach()

# Secured configurations, with the tunnel's, the page that makes their keys, and what the robot's unit is told.
foreach(file README.md gateway.yaml master.yaml pool.yaml topology.yaml registry-tls.conf)
  install_prefixed(deploy/fleet/${file} share/doc/iotcloud/fleet)
endforeach()
install_prefixed(deploy/systemd/registry-tunnel.conf share/doc/iotcloud/fleet)
install_prefixed(deploy/systemd/robot.env share/doc/iotcloud)

# For one machine, with every key explained. In the project they are for daemons that one person starts there; installed they are
# for the units, whose hosts and workers have users of their own.
set(samples share/doc/iotcloud/config)
install_prefixed(config/gateway.yaml ${samples} CHANGES
  "plugins: build/release/plugins" "plugins: /usr/lib/iotcloud/plugins"
  "state: build/state/gateway-1" "state: /var/lib/iotcloud-gateway/state"
  "thrift: {host: 127.0.0.1, port: 12905}" "thrift: {host: 127.0.0.1, port: 12905, users: [iotcloud-master]}"
  "# host_user: iotcloud-drivers" "host_user: iotcloud-host"
  "# host_starter: /run/iotcloud-host" "host_starter: /run/iotcloud-host")
install_prefixed(config/pool.yaml ${samples} CHANGES
  "state: build/state/pool-1" "state: /var/lib/iotcloud-pool/state"
  "thrift: {host: 127.0.0.1, port: 0}" "thrift: {host: 127.0.0.1, port: 0, users: [iotcloud-master]}"
  "# worker_user: iotcloud-worker" "worker_user: iotcloud-worker"
  "# worker_starter: /run/iotcloud-worker" "worker_starter: /run/iotcloud-worker")
install_prefixed(config/master.yaml ${samples})
install_prefixed(config/topology.yaml ${samples})
install_prefixed(config/fleet.yaml ${samples})
foreach(example fleet_map/fleet_map thermostat/thermostat storm_mix/mix turtlebot_follower/follower)
  get_filename_component(folder ${example} DIRECTORY)
  install_prefixed(examples/${example}.yaml share/doc/iotcloud/examples/${folder})
endforeach()
