#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <unistd.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/gateway/plugins/plugin_folder.h>
#include <iotcloud/gateway/processes/process_launcher.h>
#include <iotcloud/gateway/processes/process_link.h>
#include <iotcloud/gateway/processes/silence.h>

namespace iotcloud::gateway {

namespace {

constexpr config::Logger log{"gateway"};
constexpr std::chrono::milliseconds hello_limit{2000}, hello_pause{100};
constexpr std::string_view socket_suffix = ".sock";

std::string beside_own_program() {
  std::error_code error;
  const auto own = std::filesystem::read_symlink("/proc/self/exe", error);
  return own.parent_path() / "iotcloud-driver-host";
}

/// What a child of the gateway must not inherit: its session, its signals, its descriptors (sockets above all).
class Spawning {
 public:
  explicit Spawning(const std::string& log_file) {
    posix_spawn_file_actions_init(&actions_);
    posix_spawn_file_actions_addopen(&actions_, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_addopen(&actions_, STDOUT_FILENO, log_file.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
    posix_spawn_file_actions_adddup2(&actions_, STDOUT_FILENO, STDERR_FILENO);
    posix_spawn_file_actions_addclosefrom_np(&actions_, STDERR_FILENO + 1);
    posix_spawnattr_init(&attributes_);
    posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSID | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    sigset_t set;
    sigemptyset(&set);
    posix_spawnattr_setsigmask(&attributes_, &set);
    sigfillset(&set);
    posix_spawnattr_setsigdefault(&attributes_, &set);
  }
  ~Spawning() {
    posix_spawn_file_actions_destroy(&actions_);
    posix_spawnattr_destroy(&attributes_);
  }
  Spawning(const Spawning&) = delete;
  Spawning& operator=(const Spawning&) = delete;

  /// \return the child's id. \throws config::Error.
  pid_t spawn(std::vector<std::string> arguments) {
    std::vector<char*> argv;
    argv.reserve(arguments.size() + 1);
    for (auto& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_t child = 0;
    const int error = posix_spawn(&child, argv[0], &actions_, &attributes_, argv.data(), environ);
    if (error != 0) throw config::Error(fmt::format("{} cannot be started: {}", arguments[0], std::strerror(error)));
    return child;
  }

 private:
  posix_spawn_file_actions_t actions_;
  posix_spawnattr_t attributes_;
};

void add_confinement(std::vector<std::string>& arguments, const Confinement& confinement) {
  if (!confinement.user.empty()) arguments.insert(arguments.end(), {"--user", confinement.user});
  if (confinement.open_files > 0) {
    arguments.insert(arguments.end(), {"--open-files", std::to_string(confinement.open_files)});
  }
  if (confinement.no_new_privileges) arguments.emplace_back("--no-new-privileges");
  if (!confinement.debuggable) arguments.emplace_back("--no-debugging");
  if (confinement.filter_calls) arguments.emplace_back("--filter-calls");
}

std::optional<protocol::Event> hello_of(const OwnedDescriptor& socket) {
  protocol::FrameReader frames;
  Silence silence(std::chrono::steady_clock::now(), 2 * hello_pause);
  while (silence.look(std::chrono::steady_clock::now()) < hello_limit) {
    if (!wait_readable(socket.get(), hello_pause)) continue;
    const auto bytes = receive_some(socket);
    if (!bytes) break;
    frames.feed(bytes->data(), bytes->size());
    if (const auto body = frames.next()) return protocol::decode_event(*body);
  }
  return std::nullopt;
}

/// The host behind a socket of an earlier life, when it is one to go on with. One that is not is ended.
std::optional<RunningHost> examine(const std::string& folder, const std::string& name, const std::string& gateway,
                                   const HostAccount* account) {
  const OwnedDescriptor socket = connect_in(folder, name);
  if (!socket) {
    unlink((folder + "/" + name).c_str());  // its host is dead
    return std::nullopt;
  }
  const int process = peer_process(socket);
  std::string problem;
  try {
    const auto hello = hello_of(socket);
    if (!hello) {
      problem = "it does not answer";
    } else if (hello->version != protocol::version || hello->order.gateway != gateway) {
      problem = "it is of another version or another gateway";
    } else if (account != nullptr && !account->runs(process)) {
      problem = "it runs as another user than host_user says";
    } else {
      return RunningHost{name, hello->order, hello->instances};
    }
  } catch (const config::Error& e) {
    problem = e.what();
  }
  log.warn("the driver host {} (process {}) of an earlier life is ended: {}", name, process, problem);
  if (process > 0) kill(process, SIGKILL);
  unlink((folder + "/" + name).c_str());
  return std::nullopt;
}

}  // namespace

ProcessLauncher::ProcessLauncher(Options options)
    : options_(std::move(options)), source_(options_.plugin_dir, options_.store, options_.trust) {
  if (options_.host_program.empty()) options_.host_program = beside_own_program();
  if (access(options_.host_program.c_str(), X_OK) != 0) {
    throw config::Error(fmt::format("the driver host program {} cannot be run: {}; it belongs beside the gateway's own",
                                    options_.host_program, std::strerror(errno)));
  }
  if (!std::filesystem::is_directory(options_.plugin_dir)) {
    throw config::Error(fmt::format("the plugin folder {} is not there", options_.plugin_dir));
  }
  check_plugin_folder(options_.plugin_dir);
  if (!options_.confinement.user.empty() && geteuid() == 0) {
    account_ = std::make_shared<HostAccount>(options_.confinement.user, options_.state_dir);
  }
}

LogFile::Options ProcessLauncher::log_of(const std::string& plugin) const {
  return {fmt::format("{}/{}.log", options_.state_dir, plugin.substr(0, plugin.rfind('.'))),
          static_cast<std::uint64_t>(options_.log_limit_mb) << 20, options_.logs_kept};
}

std::function<void()> ProcessLauncher::log_keeper(const std::string& plugin) const {
  if (!account_) return {};
  return [account = account_, log_file = log_of(plugin)] { account->keep_within_bounds(log_file); };
}

bool ProcessLauncher::wants_isolation(const HostOrder& order) try {
  return source_.find(order).isolated;
} catch (const config::Error&) {
  return false;  // launch() says what is wrong
}

std::unique_ptr<HostLink> ProcessLauncher::launch(const HostOrder& wanted, HostEvents events) try {
  const auto found = source_.find(wanted);
  HostOrder order = wanted;
  order.identity = found.identity;
  // A name of its own for each host: one that ends and its successor do not get in each other's way.
  const std::string socket = discovery::new_instance_id().substr(0, 12) + std::string(socket_suffix);
  const std::string log_file = log_of(order.plugin).path;
  if (account_) account_->make_log(log_file);
  // clang-format off
  std::vector<std::string> arguments = {
      options_.host_program,
      "--plugin", found.path,
      "--name=" + order.plugin,  // in one word: it may begin with a dash
      "--sha256", order.identity.sha256,
      "--gateway", order.gateway,
      "--state", options_.state_dir,
      "--socket", socket,
      "--log", log_file,
      "--log-limit-mb", std::to_string(options_.log_limit_mb),
      "--logs-kept", std::to_string(options_.logs_kept)};
  // clang-format on
  if (order.isolated) arguments.emplace_back("--isolated");
  const auto as_this_process = config::log_options();
  arguments.insert(arguments.end(), as_this_process.begin(), as_this_process.end());
  add_confinement(arguments, options_.confinement);
  if (found.exactly) arguments.emplace_back("--exactly");
  if (!order.sha256.empty()) arguments.push_back("--ordered=" + order.sha256);
  if (!order.identity.signed_by.empty()) arguments.push_back("--signed-by=" + order.identity.signed_by);
  const pid_t process = Spawning(log_file).spawn(std::move(arguments));
  log.info("started the driver host of {} as process {}; it logs to {}", order.plugin, process, log_file);
  return std::make_unique<ProcessLink>(options_, order, socket, process, true, std::move(events),
                                       log_keeper(order.plugin));
} catch (const config::Error& e) {
  events.on_ended({HostEnd::How::refused, e.what(), ""});
  return link_to_nothing();
}

std::vector<RunningHost> ProcessLauncher::running(const std::string& gateway) {
  std::vector<RunningHost> hosts;
  std::error_code error;
  for (const auto& file : std::filesystem::directory_iterator(options_.state_dir, error)) {
    const std::string name = file.path().filename();
    if (!name.ends_with(socket_suffix)) continue;
    if (auto host = examine(options_.state_dir, name, gateway, account_.get())) hosts.push_back(std::move(*host));
  }
  return hosts;
}

std::unique_ptr<HostLink> ProcessLauncher::adopt(const RunningHost& host, HostEvents events) {
  const int process = peer_process(connect_in(options_.state_dir, host.name));
  return std::make_unique<ProcessLink>(options_, host.order, host.name, process, false, std::move(events),
                                       log_keeper(host.order.plugin));
}

}  // namespace iotcloud::gateway
