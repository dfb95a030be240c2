#include <algorithm>
#include <list>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include <fcntl.h>
#include <poll.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/control_server.h>
#include <iotcloud/gateway/host/driver_host.h>
#include <iotcloud/gateway/host/logger.h>
#include <iotcloud/gateway/host/protocol.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/processes/outbox.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

using std::chrono::milliseconds;

namespace {

constexpr milliseconds stop_limit{4000};
/// Connections that have not proved that they are the gateway's. With more than that the oldest is closed.
constexpr std::size_t most_strangers = 16;
constexpr std::size_t longest_proof = 4096;     ///< bytes of the first frame
constexpr std::size_t most_unread = 64u << 20;  ///< bytes that wait for a gateway that stands still
constexpr milliseconds log_pause{2000};         ///< the longest pause between checks of the log's size

/// Whether a command of this kind is for instances, of which a host that refused its plugin has none.
template <typename Command>
constexpr bool is_for_instances = true;
template <>
constexpr bool is_for_instances<protocol::ShutDown> = false;
template <>
constexpr bool is_for_instances<protocol::Ping> = false;
template <>
constexpr bool is_for_instances<protocol::AskForSamples> = false;

}  // namespace

struct ControlServer::Impl {
  explicit Impl(Options given)
      : options(std::move(given)),
        log_file(options.log),
        listener(options.socket < 0 ? processes::listen_in(options.folder, options.socket_name)
                                    : processes::OwnedDescriptor(options.socket)) {
    if (options.socket >= 0) {
      fcntl(listener.get(), F_SETFD, FD_CLOEXEC);
      processes::listen_on(listener);
    }
    try {
      processes::confine(options.confinement);
      DriverHost::Options host_options;
      host_options.gateway = options.order.gateway;
      host_options.isolated = options.order.isolated;
      host_options.state_folder = options.folder;
      host_options.passing.pass = [this](const PassedMessage& message) -> std::optional<NotPassed> {
        std::string bytes = encode(protocol::PassMessage{message});
        if (!processes::fits(bytes)) return NotPassed::too_large;
        if (!send(std::move(bytes))) return NotPassed::gateway_away;
        return std::nullopt;
      };
      host_options.passing.answer = [this](std::int64_t number, PassAnswer answer) {
        tell(protocol::AnswerMessage{number, answer});
      };
      host_options.on_found = [this](FoundReport report) { tell(protocol::FoundMessage{std::move(report)}); };
      const auto& order = options.order;
      auto plugin = options.exactly ? Plugin::load_exactly(options.plugin_path, order.identity.sha256, order.plugin)
                                    : Plugin::load(options.plugin_path);
      host.emplace(host_options, std::move(plugin),
                   [this](const InstanceStatus& status) { tell(protocol::StatusChange{status}); });
    } catch (const std::exception& e) {
      refusal = e.what();
      host_logger.error("{}", refusal);
    }
  }

  void tell(const protocol::HostReport& report);
  bool send(std::string frame);
  /// A connection of somebody who has not proved to be the gateway.
  struct Stranger {
    processes::OwnedDescriptor connection;
    processes::FrameReader frames;
    std::size_t heard = 0;  ///< bytes
  };
  void accept_stranger();
  void hear(Stranger stranger);
  bool proves(const std::string& body) const;
  void take_gateway(Stranger proved);
  void obey_all();
  void greet();
  void send_waiting();
  void receive();
  // Commands for instances (is_for_instances) are obeyed only while `host` is set.
  void obey(const protocol::CreateInstance& command) { host->create(command.spec); }
  void obey(const protocol::ActivateInstance& command) { host->activate(command.instance); }
  void obey(const protocol::DeactivateInstance& command) { host->deactivate(command.instance); }
  void obey(const protocol::RemoveInstance& command) { host->remove(command.instance, command.removal); }
  void obey(const protocol::DeliverMessage& command) { host->deliver(command.passed); }
  void obey(const protocol::AnswerMessage& command) { host->answered(command.number, command.answer); }
  void obey(const protocol::RenewLeases& command) { host->renew(config::Clock::Instant(command.confirmed)); }
  void obey(const protocol::AskAboutChannel& command);
  void obey(const protocol::ShutDown& command) { shutdown_limit = command.limit; }
  void obey(const protocol::Ping& command);
  void obey(const protocol::AskForSamples&) { tell(protocol::HostSamples{config::process_metrics().collect()}); }
  static void obey(const protocol::ProveGateway& /*again*/) {}
  void lose_gateway(const char* why);
  int stop(milliseconds limit);

  const Options options;
  const processes::LogFile log_file;
  processes::OwnedDescriptor listener;
  processes::OwnedDescriptor gateway;
  processes::FrameReader frames;
  processes::Outbox outbox;  ///< for the gateway
  std::list<Stranger> strangers;
  processes::Waker waker;
  std::string refusal;
  std::optional<milliseconds> shutdown_limit;
  config::Clock::Instant useful = config::system_clock().now();

  config::Mutex mutex;
  bool connected IOTCLOUD_GUARDED_BY(mutex) = false;
  std::vector<std::string> waiting IOTCLOUD_GUARDED_BY(mutex);  ///< frames to send

  std::optional<DriverHost> host;  ///< last, because its events use the other members
};

ControlServer::ControlServer(Options options) : impl_(std::make_unique<Impl>(std::move(options))) {}

ControlServer::~ControlServer() = default;

/// Sends a report to the gateway. Any thread may call it. Without a connection the report is dropped, because the
/// greeting to the next gateway contains the state of all instances.
void ControlServer::Impl::tell(const protocol::HostReport& report) {
  send(encode(report));
}

/// \return whether there is a connection
bool ControlServer::Impl::send(std::string frame) {
  const config::MutexLock lock(mutex);
  if (!connected) return false;
  waiting.push_back(std::move(frame));
  waker.wake();
  return true;
}

void ControlServer::Impl::accept_stranger() {
  processes::OwnedDescriptor fresh = processes::accept_from(listener);
  if (!fresh) return;
  if (!processes::peer_may_connect(fresh, listener)) {
    host_logger.error("process {} of another user connected to this host as if it were the gateway; it is cut off",
                      processes::peer_process(fresh));
    return;
  }
  if (strangers.size() >= most_strangers) strangers.pop_front();
  strangers.push_back({std::move(fresh), {}, 0});
}

/// Listens to somebody whose connection has something to read.
void ControlServer::Impl::hear(Stranger stranger) {
  const auto bytes = processes::receive_some(stranger.connection);
  if (!bytes) return;
  stranger.heard += bytes->size();
  stranger.frames.feed(bytes->data(), bytes->size());
  try {
    const auto first = stranger.frames.next();
    if (first && proves(*first)) return take_gateway(std::move(stranger));
    if (!first && stranger.heard <= longest_proof) return strangers.push_back(std::move(stranger));
  } catch (const std::exception& e) {
    host_logger.debug("the first words of a connection: {}", e.what());
  }
  host_logger.error("process {} connected to this host and is not its gateway; it is cut off",
                    processes::peer_process(stranger.connection));
}

bool ControlServer::Impl::proves(const std::string& body) const {
  const auto command = protocol::decode_command(body);
  const auto* shown = std::get_if<protocol::ProveGateway>(&command);
  return shown != nullptr && security::sha256_hex(shown->proof) == options.proof_check;
}

void ControlServer::Impl::take_gateway(Stranger proved) {
  // A host has one gateway at a time. A dead gateway's connection ended before its next run connected, but commands
  // that it sent before its end may still stand before that end.
  while (gateway && processes::wait_readable(gateway.get(), milliseconds{0})) receive();
  if (gateway) return;
  gateway = std::move(proved.connection);
  frames = std::move(proved.frames);
  {
    const config::MutexLock lock(mutex);
    waiting.clear();
    // set before greet() lists the instances, so that changes from now on are reported after the list
    connected = true;
  }
  greet();
  if (gateway) obey_all();
}

void ControlServer::Impl::greet() {
  protocol::HostHello hello;
  hello.order = options.order;
  hello.answers = true;
  if (host) hello.instances = host->list();
  outbox.add(encode(hello));
  if (!refusal.empty()) outbox.add(encode(protocol::PluginRefused{refusal}));
  if (!outbox.send(gateway)) return lose_gateway("it went at once");
  if (host) host->tell_found();
}

void ControlServer::Impl::send_waiting() {
  waker.clear();
  {
    const config::MutexLock lock(mutex);
    for (const auto& bytes : waiting) outbox.add(bytes);
    waiting.clear();
  }
  if (!gateway) return;
  if (!outbox.send(gateway)) {
    lose_gateway("it does not read any more");
  } else if (outbox.size() > most_unread) {
    lose_gateway("it does not read what this host says");
  }
}

void ControlServer::Impl::receive() {
  const auto bytes = processes::receive_some(gateway);
  if (!bytes) {
    lose_gateway("it closed the connection");
    return;
  }
  frames.feed(bytes->data(), bytes->size());
  obey_all();
}

void ControlServer::Impl::obey_all() {
  try {
    while (const auto body = frames.next()) {
      std::visit(
          [this](const auto& command) {
            if (host || !is_for_instances<std::remove_cvref_t<decltype(command)>>) obey(command);
          },
          protocol::decode_command(*body));
    }
  } catch (const std::exception& e) {
    lose_gateway(e.what());
  }
}

void ControlServer::Impl::lose_gateway(const char* why) {
  host_logger.warn("the gateway is gone ({}); this host goes on and waits for it", why);
  gateway.reset();
  outbox.clear();
  {
    const config::MutexLock lock(mutex);
    connected = false;
    waiting.clear();
  }
  if (host) host->nobody_answers();
}

void ControlServer::Impl::obey(const protocol::Ping& command) {
  protocol::Pong pong;
  pong.number = command.number;
  if (host) {
    pong.stalls = host->stalls();
    pong.brokers = host->brokers();
    pong.losing = host->losing();
  }
  tell(pong);
}

void ControlServer::Impl::obey(const protocol::AskAboutChannel& command) {
  host->ask(command.question, [this, number = command.number](discovery::ChannelLook look) {
    tell(protocol::ChannelAnswer{number, std::move(look)});
  });
}

int ControlServer::Impl::stop(milliseconds limit) {
  const bool in_order = !host || host->stop(limit);
  send_waiting();
  if (gateway) processes::send_all(gateway, outbox.take());
  return in_order ? 0 : 1;
}

int ControlServer::run(int signals) {
  auto& self = *impl_;
  const auto& clock = config::system_clock();
  while (!self.shutdown_limit) {
    std::vector<pollfd> on{
        {self.listener.get(), POLLIN, 0},
        {self.waker.get(), POLLIN, 0},
        {signals, POLLIN, 0},
        // poll() ignores descriptor -1
        {self.gateway.get(), static_cast<short>(self.outbox.empty() ? POLLIN : POLLIN | POLLOUT), 0}};
    for (const auto& stranger : self.strangers) on.push_back({stranger.connection.get(), POLLIN, 0});
    auto pause = std::min(self.options.orphan_limit, log_pause);
    const auto lease = self.host ? self.host->enforce_leases() : std::nullopt;
    if (lease) pause = std::min(pause, *lease);
    const std::size_t first_stranger = 4;
    poll(on.data(), on.size(), static_cast<int>(pause.count()));
    self.log_file.rotate_if_too_long();
    if (on[2].revents != 0) self.shutdown_limit = stop_limit;
    if (on[1].revents != 0 || (on[3].revents & POLLOUT) != 0) self.send_waiting();
    if ((on[3].revents & ~POLLOUT) != 0 && self.gateway) self.receive();
    auto strangers = std::exchange(self.strangers, {});
    for (std::size_t i = first_stranger; i < on.size(); ++i) {
      if (on[i].revents != 0) {
        self.hear(std::move(strangers.front()));
      } else {
        self.strangers.push_back(std::move(strangers.front()));
      }
      strangers.pop_front();
    }
    if (on[0].revents != 0) self.accept_stranger();
    if (self.gateway || (self.host && !self.host->list().empty())) {
      self.useful = clock.now();
    } else if (clock.now() - self.useful >= self.options.orphan_limit) {
      host_logger.info("no gateway and no instances: this host ends");
      return 0;
    }
  }
  return self.stop(*self.shutdown_limit);
}

}  // namespace iotcloud::gateway
