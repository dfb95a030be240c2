#include <algorithm>
#include <array>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include <poll.h>

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/host/control/control_server.h>
#include <iotcloud/gateway/host/control/protocol.h>
#include <iotcloud/gateway/host/control/unix_socket.h>
#include <iotcloud/gateway/host/driver_host.h>

namespace iotcloud::gateway {

using protocol::Command;
using protocol::Event;
using std::chrono::milliseconds;

namespace {

constexpr config::Logger log{"gateway.host"};
constexpr milliseconds stop_limit{4000};
constexpr milliseconds log_pause{2000};  ///< at most, between looks at the log's size

}  // namespace

struct ControlServer::Impl {
  explicit Impl(Options given)
      : options(std::move(given)), log_file(options.log), listener(listen_in(options.folder, options.socket_name)) {
    try {
      confine(options.confinement);
      DriverHost::Options host_options;
      host_options.gateway = options.order.gateway;
      host_options.isolated = options.order.isolated;
      host_options.state_folder = options.folder;
      const auto& order = options.order;
      auto plugin = options.exactly ? Plugin::load_exactly(options.plugin_path, order.identity.sha256, order.plugin)
                                    : Plugin::load(options.plugin_path);
      host.emplace(host_options, std::move(plugin), [this](const InstanceStatus& status) {
        Event event;
        event.kind = Event::Kind::status;
        event.status = status;
        tell(event);
      });
    } catch (const std::exception& e) {
      refusal = e.what();
      log.error("{}", refusal);
    }
  }

  void tell(const Event& event);
  void accept_gateway();
  void greet();
  void send_waiting();
  void receive();
  void obey(const Command& command);
  void lose_gateway(const char* why);
  int stop(milliseconds limit);

  const Options options;
  const LogFile log_file;
  OwnedDescriptor listener;
  OwnedDescriptor gateway;
  protocol::FrameReader frames;
  Waker waker;
  std::string refusal;
  std::optional<milliseconds> shutdown_limit;
  config::Clock::Instant useful = config::system_clock().now();

  std::mutex mutex;
  bool connected = false;            ///< guarded by mutex
  std::vector<std::string> waiting;  ///< frames to send; guarded by mutex

  std::optional<DriverHost> host;  ///< last: its events use the rest
};

ControlServer::ControlServer(Options options) : impl_(std::make_unique<Impl>(std::move(options))) {}

ControlServer::~ControlServer() = default;

/// From any thread. Without a gateway nothing is kept: the next one is greeted with all there is.
void ControlServer::Impl::tell(const Event& event) {
  const std::lock_guard lock(mutex);
  if (!connected) return;
  waiting.push_back(encode(event));
  waker.wake();
}

void ControlServer::Impl::accept_gateway() {
  OwnedDescriptor fresh = accept_from(listener);
  if (!fresh || gateway) return;  // one gateway at a time; a dead one's connection has ended before its next life comes
  gateway = std::move(fresh);
  frames = {};
  {
    const std::lock_guard lock(mutex);
    waiting.clear();
    connected = true;  // before the list is made: what changes meanwhile is told after it
  }
  greet();
}

void ControlServer::Impl::greet() {
  Event hello;
  hello.kind = Event::Kind::hello;
  hello.order = options.order;
  if (host) hello.instances = host->list();
  bool taken = send_all(gateway, encode(hello));
  if (taken && !refusal.empty()) {
    Event refused;
    refused.kind = Event::Kind::refused;
    refused.reason = refusal;
    taken = send_all(gateway, encode(refused));
  }
  if (!taken) lose_gateway("it went at once");
}

void ControlServer::Impl::send_waiting() {
  waker.clear();
  std::vector<std::string> now;
  {
    const std::lock_guard lock(mutex);
    now.swap(waiting);
  }
  for (const auto& bytes : now) {
    if (gateway && !send_all(gateway, bytes)) lose_gateway("it does not read");
  }
}

void ControlServer::Impl::receive() {
  const auto bytes = receive_some(gateway);
  if (!bytes) {
    lose_gateway("it closed the connection");
    return;
  }
  frames.feed(bytes->data(), bytes->size());
  try {
    while (const auto body = frames.next()) obey(protocol::decode_command(*body));
  } catch (const std::exception& e) {
    lose_gateway(e.what());
  }
}

void ControlServer::Impl::lose_gateway(const char* why) {
  log.warn("the gateway is gone ({}); this host goes on and waits for it", why);
  gateway.reset();
  const std::lock_guard lock(mutex);
  connected = false;
  waiting.clear();
}

void ControlServer::Impl::obey(const Command& command) {
  if (command.kind == Command::Kind::shutdown) {
    shutdown_limit = milliseconds(command.number);
    return;
  }
  if (command.kind == Command::Kind::ping) {
    Event pong;
    pong.kind = Event::Kind::pong;
    pong.number = command.number;
    if (host) pong.stalls = host->stalls();
    tell(pong);
    return;
  }
  if (command.kind == Command::Kind::metrics) {
    Event metrics;
    metrics.kind = Event::Kind::metrics;
    metrics.samples = config::process_metrics().collect();
    tell(metrics);
    return;
  }
  if (!host) return;
  switch (command.kind) {
    case Command::Kind::create:
      host->create(*command.spec);
      break;
    case Command::Kind::activate:
      host->activate(command.instance);
      break;
    case Command::Kind::deactivate:
      host->deactivate(command.instance);
      break;
    case Command::Kind::remove:
      host->remove(command.instance);
      break;
    case Command::Kind::shutdown:
    case Command::Kind::ping:
    case Command::Kind::metrics:
      break;
  }
}

int ControlServer::Impl::stop(milliseconds limit) {
  const bool in_order = !host || host->stop(limit);
  send_waiting();
  return in_order ? 0 : 1;
}

int ControlServer::run(int signals) {
  auto& self = *impl_;
  const auto& clock = config::system_clock();
  while (!self.shutdown_limit) {
    std::array<pollfd, 4> on{{{self.listener.get(), POLLIN, 0},
                              {self.waker.get(), POLLIN, 0},
                              {signals, POLLIN, 0},
                              {self.gateway.get(), POLLIN, 0}}};  // -1 is not polled
    poll(on.data(), on.size(), static_cast<int>(std::min(self.options.orphan_limit, log_pause).count()));
    self.log_file.look();
    if (on[2].revents != 0) self.shutdown_limit = stop_limit;
    if (on[1].revents != 0) self.send_waiting();
    if (on[3].revents != 0) self.receive();
    if (on[0].revents != 0) self.accept_gateway();
    if (self.gateway || (self.host && !self.host->list().empty())) {
      self.useful = clock.now();
    } else if (clock.now() - self.useful >= self.options.orphan_limit) {
      log.info("no gateway and no instances: this host ends");
      return 0;
    }
  }
  return self.stop(*self.shutdown_limit);
}

}  // namespace iotcloud::gateway
