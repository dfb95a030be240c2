#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/topology/local/local_cluster.h>
#include <iotcloud/topology/plugin.h>

/// Tests a topology without servers and devices: link iotcloud::topology_testing.
namespace iotcloud::topology::testing {

/// The contents of a World.
struct WorldOptions {
  /// The drivers that the test plays itself, by name, with the channels of each instance.
  std::map<std::string, std::vector<drivers::ChannelSpec>> fakes{};
  /// Real drivers that are linked in, by the name that World::deploy() takes. They must outlive the world.
  std::map<std::string, const drivers::Descriptor*> drivers{};
  /// The folder of plugins: component libraries that a topology names, and real drivers. May be empty.
  std::string plugin_dir{};
  std::vector<std::string> gateways{"gateway-1"};
  /// The names of brokers that topologies and channels use. An embedded broker stands in for each.
  std::vector<std::string> brokers{"rabbitmq"};
};

/// An instance of a driver that the test plays: it sends what the test says and keeps what it gets. It is the World's,
/// and lives as long. Thread safe.
class FakeInstance {
 public:
  FakeInstance();
  ~FakeInstance();

  /// Its id in this world: `driverID` of the tuples that come from it.
  const std::string& id() const;
  /// Sends on an outgoing channel, and waits up to 20 s for room on a channel that blocks.
  /// \throws std::invalid_argument for a channel that the driver does not send on; the text names those that it does.
  /// \throws std::runtime_error when the channel has no room, or the world was stopped.
  void publish(std::string_view channel, drivers::Message message);
  /// The same with this text, and the present time.
  void publish(std::string_view channel, std::string_view text);
  /// Sets metadata of the instance, as DriverContext::update_metadata(). \throws std::runtime_error when the world was
  /// stopped.
  void update_metadata(const drivers::PropertyMap& changes);
  /// All that it got on an incoming channel so far, in order.
  /// \throws std::invalid_argument for a channel that the driver does not get messages on.
  std::vector<drivers::Message> received(std::string_view channel) const;
  /// Waits until it has got `count` messages on an incoming channel. \return all that it got: fewer when `limit` is
  /// over. \throws as received().
  std::vector<drivers::Message> wait_for(std::string_view channel, std::size_t count,
                                         std::chrono::milliseconds limit = std::chrono::seconds(20)) const;

 private:
  friend class World;
  friend class FakeDriver;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// A world of drivers and channels for tests of whole topologies: registry, broker, master, gateways and workers in
/// this process (a local::LocalCluster), and drivers that the test plays. The topology's file is the one that runs on a
/// cluster. Time is real here; SimulatedTopology (<iotcloud/topology/runtime/complete_topology.h>) simulates it. A
/// world sees no other world. Thread safe, except for the destructor.
class World {
 public:
  /// Starts everything but topologies. \throws config::Error.
  explicit World(WorldOptions options);
  /// Calls stop() with a limit of five seconds if it was not called.
  ~World();

  /// Runs a worker of the topology in this YAML file. It looks for the component library beside the file and in
  /// `plugin_dir`. \param components linked-in components, in addition to those of the library.
  /// \throws config::ConfigError, config::Error.
  void run(const std::string& yaml_file, ComponentRegistry components = {});
  /// Runs the topology in this text. \param name what errors call the text. \throws as run().
  void run_text(std::string_view yaml, const std::string& name, ComponentRegistry components = {});

  /// Adds an instance of one of the `fakes`, and waits until it is active. \param gateway empty: the first one.
  /// \throws std::invalid_argument for a driver that is not among the fakes, config::Error with the reason of a
  /// failure.
  FakeInstance& add(const std::string& driver, const std::string& gateway = {});
  /// Deploys an instance of a real driver, and waits until it is active. \param driver a name in `drivers`, or a file
  /// in `plugin_dir`. \return the instance's id. \throws config::Error with the reason of a failure.
  std::string deploy(const std::string& driver, const drivers::PropertyMap& properties = {},
                     const std::string& gateway = {});
  /// Takes an instance away, fake or real, and waits until it is gone. \throws config::Error.
  void undeploy(const std::string& id);

  /// Stops topologies, then drivers, within `limit`. \return false if one of them did not stop in time.
  bool stop(std::chrono::milliseconds limit = std::chrono::seconds(10));

  /// For what this class does not offer.
  local::LocalCluster& cluster();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology::testing
