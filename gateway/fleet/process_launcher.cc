#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>
#include <variant>

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/gateway/fleet/plugin_folder.h>
#include <iotcloud/gateway/fleet/process_launcher.h>
#include <iotcloud/gateway/fleet/process_link.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/silence.h>
#include <iotcloud/processes/unix_socket.h>

namespace iotcloud::gateway {

namespace {

constexpr std::chrono::milliseconds hello_pause{100};
constexpr std::string_view socket_suffix = ".sock";
/// Lines of the file with network_suffix: with the deployment's property as it is, and with each place.
constexpr std::string_view of_deployment = "deployment ", of_place = "place ";

void add_confinement(std::vector<std::string>& arguments, const processes::Confinement& confinement) {
  if (!confinement.user.empty()) arguments.insert(arguments.end(), {"--user", confinement.user});
  if (confinement.open_files > 0) {
    arguments.insert(arguments.end(), {"--open-files", std::to_string(confinement.open_files)});
  }
  if (confinement.no_new_privileges) arguments.emplace_back("--no-new-privileges");
  if (!confinement.debuggable) arguments.emplace_back("--no-debugging");
  if (confinement.processes > 0) {
    arguments.insert(arguments.end(), {"--processes", std::to_string(confinement.processes)});
  }
  if (confinement.filter_calls) arguments.emplace_back("--filter-calls");
}

void add_ports(std::vector<std::string>& arguments, const processes::PortsByCode& ports, const std::string& plugin) {
  for (const std::uint16_t port : processes::ports_of(ports, plugin).value_or(std::vector<std::uint16_t>()))
    arguments.push_back("--connect-to=" + std::to_string(port));
}

/// \param places nullopt: no restriction
void add_places(std::vector<std::string>& arguments, const std::optional<std::vector<processes::Place>>& places) {
  if (!places) return;
  arguments.emplace_back("--only-places");
  for (const auto& place : *places) arguments.push_back("--place=" + to_text(place));
}

void add_files(std::vector<std::string>& arguments, const processes::FileAccess& configured,
               const ProcessLauncher::Options& options, const std::string& plugin) {
  processes::FileAccess files = configured;
  const auto& readable_by_all = processes::readable_by_all();
  files.read.insert(files.read.end(), readable_by_all.begin(), readable_by_all.end());
  files.read.insert(files.read.end(), {plugin, options.plugin_dir});
  // Which devices there are is the business of their owners and of systemd (DeviceAllow). The gateway's own files in
  // its state folder, and the hosts' sockets there, are out of reach.
  files.write.insert(files.write.end(),
                     {"/dev", options.state_dir + "/spool", ProcessLauncher::log_folder(options.state_dir)});
  for (const auto& path : files.read) arguments.push_back("--readable=" + path);
  for (const auto& path : files.write) arguments.push_back("--writable=" + path);
}

/// The greeting of a host that this process has just connected to. \param silence of all these hosts together: each of
/// them has had all this time to say it. \param limit the silence after which a host counts as hanging.
std::optional<protocol::HostHello> hello_of(const processes::OwnedDescriptor& socket, processes::Silence& silence,
                                            std::chrono::milliseconds limit) {
  processes::FrameReader frames;
  for (;;) {
    const bool too_long = silence.measure(std::chrono::steady_clock::now()) >= limit;
    if (!processes::wait_readable(socket.get(), too_long ? std::chrono::milliseconds{0} : hello_pause)) {
      if (too_long) return std::nullopt;
      continue;
    }
    const auto bytes = processes::receive_some(socket);
    if (!bytes) return std::nullopt;
    frames.feed(bytes->data(), bytes->size());
    if (const auto body = frames.next()) {
      auto report = protocol::decode_report(*body);
      if (auto* hello = std::get_if<protocol::HostHello>(&report)) return std::move(*hello);
      throw config::Error("it does not greet first");
    }
  }
}

/// The socket of a host of an earlier run, and this process's connection to it.
struct FoundSocket {
  std::string name;
  processes::OwnedDescriptor connection;
};

/// Connects to all hosts of an earlier run; removes the sockets of those that have ended.
std::vector<FoundSocket> connect_to_hosts(const std::string& folder) {
  std::vector<FoundSocket> found;
  std::error_code error;
  for (const auto& file : std::filesystem::directory_iterator(folder, error)) {
    const std::string name = file.path().filename();
    if (name.ends_with(network_suffix) && !std::filesystem::exists(file.path().parent_path() / file.path().stem())) {
      unlink(file.path().c_str());  // its host has ended in order, and removed its socket
    }
    if (!name.ends_with(socket_suffix)) continue;
    if (auto connection = processes::connect_in(folder, name)) {
      found.push_back({name, std::move(connection)});
    } else {
      unlink(file.path().c_str());  // nobody listens: its host has ended
      unlink((file.path().string() + std::string(network_suffix)).c_str());
    }
  }
  return found;
}

void make_folder(const std::string& path) {
  if (mkdir(path.c_str(), S_IRWXU) != 0 && errno != EEXIST)
    throw config::Error(fmt::format("the folder {} cannot be made: {}", path, std::strerror(errno)));
}

/// What stands beside the socket of a host that was started with a list of places; empty: it was started without.
std::string network_file(const std::string& folder, const std::string& socket) {
  constexpr std::size_t most = std::size_t{1} << 20;
  const std::string file = fmt::format("{}/{}{}", folder, socket, network_suffix);
  return std::filesystem::exists(file) ? processes::read_file(file, most) : "";
}

/// The property in such a file.
std::optional<std::string> deployments_network(const std::string& text) {
  if (!text.starts_with(of_deployment)) return std::nullopt;
  return text.substr(of_deployment.size(), text.find('\n') - of_deployment.size());
}

/// Of a state folder: the brokers' files for confined hosts (BrokerFiles).
std::string broker_files_in(const std::string& state_folder) {
  return state_folder + "/broker-files";
}

/// Whether a host's instances name copies of brokers' files that are gone: the configuration names other files now, or
/// hosts are not confined to files any more.
bool lacks_copies(const std::vector<HostedInstance>& instances, const std::string& state_folder) {
  const std::string copies = broker_files_in(state_folder) + "/";
  for (const auto& instance : instances) {
    for (const auto& broker : instance.spec.brokers) {
      for (const auto& [key, file] : brokers::files_of(broker.options)) {
        if (file.starts_with(copies) && !std::filesystem::exists(file)) return true;
      }
    }
  }
  return false;
}

/// The host behind a socket that an earlier run left, if this gateway can adopt it. Kills a host that it cannot adopt.
/// \param network_text of an order, what a host that is started now would have beside its socket
std::optional<RunningHost> examine(const std::string& folder, const FoundSocket& found, const HostProofs& proofs,
                                   processes::Silence& silence, std::chrono::milliseconds hang_limit,
                                   const discovery::GatewayId& gateway, const processes::ChildStarter& starter,
                                   const std::function<std::string(const HostOrder&)>& network_text) {
  const std::string& name = found.name;
  const int process = processes::peer_process(found.connection);
  // Opened before the process is looked at: if the host ends meanwhile, its id may be another process's.
  const processes::ChildProcess host_process = starter.found(process);
  const auto made_it = processes::has_argument(process, name);
  if (!made_it) {
    logger.warn(
        "the command line of process {}, which has the socket {}, cannot be read; it counts as the driver host "
        "that made it",
        process, name);
  } else if (!*made_it) {
    logger.warn("process {} has the socket {}, but is not the driver host that made it; it is left alone", process,
                name);
    unlink((folder + "/" + name).c_str());
    return std::nullopt;
  }
  std::string problem;
  try {
    const std::string network = network_file(folder, name);
    const bool gone = !processes::send_all(found.connection, encode(protocol::ProveGateway{proofs.of(name)}));
    const auto hello = gone ? std::nullopt : hello_of(found.connection, silence, hang_limit);
    if (!hello) {
      problem = "it does not answer";
    } else if (hello->version != protocol::version || hello->order.gateway != gateway) {
      problem = "it is of another version or another gateway";
    } else if (problem = starter.objection(process); problem.empty()) {
      HostOrder order = hello->order;
      order.network = deployments_network(network);
      if (network_text(order) != network) {
        problem = "it may connect to other places than host_network and the brokers' URLs say now";
      } else if (lacks_copies(hello->instances, folder)) {
        problem = "its brokers' files are others now";
      } else {
        return RunningHost{name, order, hello->instances};
      }
    }
  } catch (const config::Error& e) {
    problem = e.what();
  }
  logger.warn("the driver host {} (process {}) that an earlier gateway process started is killed: {}", name, process,
              problem);
  host_process.kill();
  unlink((folder + "/" + name).c_str());
  unlink((folder + "/" + name + std::string(network_suffix)).c_str());
  return std::nullopt;
}

}  // namespace

ProcessLauncher::ProcessLauncher(Options options)
    : options_(std::move(options)),
      source_(options_.plugin_dir, options_.store, options_.trust, options_.trust_folder),
      versions_({options_.state_dir + "/plugin-versions", options_.allow_rollback, options_.require_version}),
      proofs_(options_.state_dir),
      starter_({options_.confinement.user, options_.starter, "iotcloud-host", "host_user"}, options_.state_dir) {
  if (options_.host_program.empty()) options_.host_program = processes::program_beside("iotcloud-driver-host");
  if (access(options_.host_program.c_str(), X_OK) != 0) {
    throw config::Error(fmt::format("the driver host program {} cannot be run: {}; it belongs beside the gateway's own",
                                    options_.host_program, std::strerror(errno)));
  }
  if (!std::filesystem::is_directory(options_.plugin_dir)) {
    throw config::Error(fmt::format("the plugin folder {} is not there", options_.plugin_dir));
  }
  check_plugin_folder(options_.plugin_dir);
  const std::string logs = log_folder(options_.state_dir), spools = options_.state_dir + "/spool";
  make_folder(logs);
  if (const auto* account = starter_.account()) {
    account->let_use(spools);
    account->let_pass(logs);
  } else {
    make_folder(spools);  // hosts that may reach it cannot make it
  }
  if (options_.confinement.files) {
    if (processes::landlock_version() == 0) {
      logger.warn("this kernel has no Landlock, so driver hosts may reach all files of their user (host_files)");
    }
    broker_files_ =
        std::make_shared<BrokerFiles>(broker_files_in(options_.state_dir), options_.broker_files, starter_.account());
    options_.confinement.files->read.push_back(broker_files_->folder());
  } else {
    const std::string of_earlier_run = broker_files_in(options_.state_dir);
    std::error_code error;
    std::filesystem::remove_all(of_earlier_run, error);
    if (error) {
      logger.warn(
          "{}, which has copies of brokers' passwords and keys that nobody needs any more, cannot be removed: {}",
          of_earlier_run, error.message());
    }
  }
}

std::string ProcessLauncher::log_folder(const std::string& state_folder) {
  return state_folder + "/logs";
}

processes::LogFile::Options ProcessLauncher::log_of(const std::string& plugin) const {
  return {fmt::format("{}/{}.log", log_folder(options_.state_dir), plugin.substr(0, plugin.rfind('.'))),
          static_cast<std::uint64_t>(options_.log_limit_mb) << 20, options_.logs_kept};
}

bool ProcessLauncher::wants_isolation(const HostOrder& order) try {
  return source_.find(order).isolated;
} catch (const config::Error&) {
  return false;  // launch() reports the error
}

std::unique_ptr<HostLink> ProcessLauncher::launch(const HostOrder& wanted, HostEvents events) try {
  const auto found = source_.find(wanted);
  HostOrder order = wanted;
  order.identity = found.identity;
  if (!order.identity.signed_by.empty()) versions_.admit(order.plugin, found.signature, order.of_update);
  // Each host has a socket name of its own, so that an ending host and its successor do not conflict.
  const std::string socket = discovery::new_instance_id().str().substr(0, 12) + std::string(socket_suffix);
  const std::string log_file = log_of(order.plugin).path;
  if (starter_.account() != nullptr) starter_.account()->make_file(log_file);
  // clang-format off
  std::vector<std::string> arguments = {
      options_.host_program,
      "--plugin", found.path,
      "--name=" + order.plugin,  // one argument, because the name may begin with a dash
      "--sha256", order.identity.sha256,
      "--gateway", order.gateway,
      "--state", options_.state_dir,
      "--socket", socket,
      "--proof-check", proofs_.check_of(socket),
      "--log", log_file,
      "--log-limit-mb", std::to_string(options_.log_limit_mb),
      "--logs-kept", std::to_string(options_.logs_kept)};
  // clang-format on
  if (order.isolated) arguments.emplace_back("--isolated");
  const auto as_this_process = config::log_options();
  arguments.insert(arguments.end(), as_this_process.begin(), as_this_process.end());
  add_confinement(arguments, options_.confinement);
  if (options_.confinement.files) add_files(arguments, *options_.confinement.files, options_, found.path);
  add_ports(arguments, options_.ports, order.plugin);
  add_places(arguments, network_of(order));
  if (starter_.passes_socket())
    arguments.insert(arguments.end(), {"--listen-on", std::to_string(processes::ChildStarter::passed_socket)});
  if (found.exactly) arguments.emplace_back("--exactly");
  if (!order.sha256.empty()) arguments.push_back("--ordered=" + order.sha256);
  if (!order.identity.signed_by.empty()) arguments.push_back("--signed-by=" + order.identity.signed_by);
  const std::string network_path = options_.state_dir + "/" + socket + std::string(network_suffix);
  const auto lacking = [&](const std::runtime_error& e) {
    unlink(network_path.c_str());
    // Of which there may be enough later: memory, processes, descriptors, room on the disk.
    events.on_ended({HostEnd::How::crashed, fmt::format("could not be started: {}", e.what()), {}});
    return link_to_nothing();
  };
  std::optional<processes::ChildProcess> process;
  try {
    const std::string network = network_text(order);
    if (!network.empty()) config::write_new_file(network_path, network, S_IRUSR | S_IWUSR);
    process.emplace(starter_.start(std::move(arguments), processes::environment_of(options_.environment),
                                   options_.state_dir, socket, log_file));
  } catch (const config::Error& e) {
    return lacking(e);
  }
  starter_.check(*process);
  logger.info("started the driver host of {} as process {}; it logs to {}", order.plugin, process->id(), log_file);
  try {
    return std::make_unique<ProcessLink>(options_, order, socket, proofs_.of(socket), *std::move(process), events,
                                         starter_.log_keeper(log_of(order.plugin)), broker_files_);
  } catch (const std::system_error& e) {
    return lacking(e);
  }
} catch (const config::Error& e) {
  events.on_ended({HostEnd::How::refused, e.what(), {}});
  return link_to_nothing();
}

/// What a host may connect to; nullopt: whatever it likes. \throws config::Error if this gateway cannot have it so.
std::optional<std::vector<processes::Place>> ProcessLauncher::network_of(const HostOrder& order) const {
  const auto configured = processes::places_of(options_.network, order.plugin);
  if (!order.network) {
    if (!configured) return std::nullopt;
    return with_brokers(*configured);
  }
  const std::string lacks = processes::lacks_for_network(options_.confinement, "host_");
  if (!lacks.empty()) {
    throw config::Error(
        fmt::format("its property `network` would restrict nothing: this gateway's configuration needs {}", lacks));
  }
  std::vector<processes::Place> places;
  try {
    places = processes::parse_places(*order.network);
  } catch (const config::Error& e) {
    throw config::Error(fmt::format("its property `network`: {}", e.what()));
  }
  const auto ports = processes::ports_of(options_.ports, order.plugin);
  for (const auto& place : places) {
    if (configured && std::find(configured->begin(), configured->end(), place) == configured->end()) {
      throw config::Error(fmt::format(
          "its property `network` names {}, which `host_network` in this gateway's configuration does not allow it",
          to_text(place)));
    }
    if (ports && std::find(ports->begin(), ports->end(), place.port) == ports->end()) {
      throw config::Error(fmt::format(
          "its property `network` names {}, whose port `host_ports` in this gateway's configuration does not allow it",
          to_text(place)));
    }
  }
  return with_brokers(std::move(places));
}

std::vector<processes::Place> ProcessLauncher::with_brokers(std::vector<processes::Place> places) const {
  places.insert(places.end(), options_.brokers_places.begin(), options_.brokers_places.end());
  std::sort(places.begin(), places.end());
  places.erase(std::unique(places.begin(), places.end()), places.end());
  return places;
}

/// What stands beside a host's socket, see network_file().
std::string ProcessLauncher::network_text(const HostOrder& order) const {
  const auto places = network_of(order);
  if (!places) return "";
  std::string text;
  if (order.network) text += fmt::format("{}{}\n", of_deployment, *order.network);
  for (const auto& place : *places) text += fmt::format("{}{}\n", of_place, to_text(place));
  if (text.empty()) text = "\n";  // a list without a place is one, too
  return text;
}

std::vector<RunningHost> ProcessLauncher::running(const discovery::GatewayId& gateway) {
  std::vector<RunningHost> hosts;
  // Connected to all of them first, so that several hosts that stand still keep this waiting only once.
  const auto found = connect_to_hosts(options_.state_dir);
  processes::Silence silence(std::chrono::steady_clock::now(), 2 * hello_pause);
  for (const auto& socket : found) {
    auto host = examine(options_.state_dir, socket, proofs_, silence, options_.hang_limit, gateway, starter_,
                        [this](const HostOrder& order) { return network_text(order); });
    if (!host) continue;
    host->order.identity.driver = source_.driver_of(host->order);  // what the host says of itself proves nothing
    hosts.push_back(std::move(*host));
  }
  return hosts;
}

std::unique_ptr<HostLink> ProcessLauncher::adopt(const RunningHost& host, HostEvents events) {
  const int process = processes::peer_process(processes::connect_in(options_.state_dir, host.name));
  return std::make_unique<ProcessLink>(options_, host.order, host.name, proofs_.of(host.name), starter_.found(process),
                                       std::move(events), starter_.log_keeper(log_of(host.order.plugin)),
                                       broker_files_);
}

void ProcessLauncher::renew_broker_files() {
  if (broker_files_) broker_files_->renew();
}

}  // namespace iotcloud::gateway
