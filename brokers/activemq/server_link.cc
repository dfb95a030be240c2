#include "iotcloud/brokers/activemq/server_link.h"

#include <algorithm>
#include <utility>

#include <proton/connection_options.hpp>
#include <proton/delivery.hpp>
#include <proton/error_condition.hpp>
#include <proton/message.hpp>
#include <proton/receiver_options.hpp>
#include <proton/sender_options.hpp>
#include <proton/session.hpp>
#include <proton/source.hpp>
#include <proton/source_options.hpp>
#include <proton/ssl.hpp>
#include <proton/target_options.hpp>
#include <proton/transport.hpp>
#include <proton/uuid.hpp>
#include <proton/work_queue.hpp>

#include "iotcloud/brokers/activemq/statistics.h"
#include "iotcloud/brokers/credentials.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

constexpr std::chrono::milliseconds tick_period{250};
constexpr std::chrono::seconds goodbye{1};
constexpr std::uint32_t largest_frame = 1U << 20U;
constexpr std::uint16_t default_port = 5672;
constexpr std::uint16_t default_tls_port = 5671;
constexpr const char* system_authorities = "/etc/ssl/certs/ca-certificates.crt";

proton::duration to_proton(std::chrono::milliseconds duration) {
  return proton::duration(static_cast<proton::duration::numeric_type>(std::max<std::int64_t>(duration.count(), 0)));
}

bool is_tls(const BrokerUrl& url) {
  return url.scheme.ends_with('s');
}

std::string proton_url(const BrokerUrl& url) {
  const bool ipv6 = url.host.find(':') != std::string::npos;
  const std::uint16_t port = url.port != 0 ? url.port : is_tls(url) ? default_tls_port : default_port;
  return (is_tls(url) ? "amqps://" : "amqp://") + (ipv6 ? "[" + url.host + "]" : url.host) + ":" + std::to_string(port);
}

std::string describe(const proton::error_condition& error) {
  if (error.empty()) return "the server closed it";
  return error.description().empty() ? error.name() : error.name() + ": " + error.description();
}

}  // namespace

/// Finds out whether the preferred server answers, while the link is connected to another.
class ServerLink::Probe final : public proton::messaging_handler {
 public:
  bool done = false;
  bool answers = false;
  Instant started;

 private:
  void on_connection_open(proton::connection& connection) override {
    answers = true;
    connection.close();
  }
  void on_transport_close(proton::transport&) override { done = true; }
  void on_transport_error(proton::transport&) override {}
  void on_connection_error(proton::connection&) override { answers = false; }
  void on_error(const proton::error_condition&) override {}
};

ServerLink::ServerLink(proton::container& container, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                       std::string purpose, ConnectionLog& log)
    : options_(options),
      container_(container),
      urls_(urls),
      purpose_(std::move(purpose)),
      clock_(options.clock != nullptr ? *options.clock : config::system_clock()),
      log_(log),
      servers_(urls.size()) {}

std::size_t ServerLink::under_way() const {
  return 0;
}

void ServerLink::start() {
  {
    const Lock lock(mutex_);
    if (std::exchange(started_, true)) return;
  }
  post([this] { tick(); });
}

void ServerLink::close() {
  Lock lock(mutex_);
  closing_ = true;
  if (!connection_) return;
  connection_.wake();  // finish() follows
  changed_.wait_until(lock, std::chrono::system_clock::now() + goodbye, [this] { return !connection_; });
}

void ServerLink::finish() {
  if (phase_ == Phase::up) say_goodbye();
  connection_.close();  // on_transport_close follows
}

void ServerLink::post(std::function<void()> work) {
  container_.schedule(proton::duration::IMMEDIATE, proton::work(std::move(work)));
}

void ServerLink::wake() {
  if (std::exchange(woken_, true) || closing_) return;
  if (connection_) {
    connection_.wake();
  } else if (started_) {
    post([this] { run_serve(); });
  }
}

void ServerLink::arm(Instant when) {
  // Later ones are seen by tick() in time; the container does not stop before its timers ran off.
  if (when >= armed_ || when > now() + tick_period) return;
  armed_ = when;
  const auto wait = std::chrono::ceil<std::chrono::milliseconds>(when - now());
  container_.schedule(to_proton(wait), proton::work(std::function<void()>([this] {
                        if (now() >= armed_) serve_in_its_turn();
                      })));
}

void ServerLink::serve_in_its_turn() {
  if (phase_ == Phase::up) {
    armed_ = Instant::max();
    connection_.wake();
  } else {
    run_serve();
  }
}

void ServerLink::run_serve() {
  armed_ = Instant::max();
  {
    const Lock lock(mutex_);
    woken_ = false;
    if (closing_) return;
  }
  guarded([this] { serve(); });
}

void ServerLink::tick() {
  io_thread_ = std::this_thread::get_id();
  {
    const Lock lock(mutex_);
    if (closing_) return;
  }
  guarded([this] { look_after(); });
  serve_in_its_turn();
  const auto wait = phase_ == Phase::away
                        ? std::chrono::ceil<std::chrono::milliseconds>(servers_.next_attempt() - now())
                        : std::chrono::milliseconds(tick_period);
  container_.schedule(to_proton(std::clamp(wait, std::chrono::milliseconds(1), tick_period)),
                      proton::work(std::function<void()>([this] { tick(); })));
}

void ServerLink::look_after() {
  if (phase_ == Phase::away) {
    if (const auto server = servers_.due(now())) attempt(*server);
    return;
  }
  if (phase_ != Phase::up) {
    if (now() > attempt_ends_) {
      abandon(phase_ == Phase::connecting
                  ? "no answer"
                  : "no answer to a question about its queues: its activemq.xml needs "
                    "<plugins><statisticsBrokerPlugin/></plugins>, and the user the right to ask");
    }
    return;
  }
  if (!questions_.empty() && now() - questions_.begin()->second.asked > options_.rpc_timeout) {
    abandon("no answer to a question about its queues");
    return;
  }
  if (probe_ && (probe_->done || now() - probe_->started > options_.rpc_timeout)) {
    servers_.asked(probe_->done && probe_->answers, now());
    if (probe_->done) probe_.reset();
  }
  if (servers_.must_move_back(now())) {
    moving_back_ = true;
    abandon("its preferred server is back");
  } else if (servers_.must_ask(now()) && !probe_) {
    probe_ = std::make_shared<Probe>();
    probe_->started = now();
    proton::connection_options options = connection_options(urls_[client::ServerList::preferred]);
    options.handler(*probe_);
    container_.connect(proton_url(urls_[client::ServerList::preferred]), options);
  }
}

proton::connection_options ServerLink::connection_options(const BrokerUrl& url) const {
  const Credentials credentials = credentials_for(options_, url);
  proton::connection_options options;
  // The server knows connections by this name and wants each once.
  options.container_id("iotcloud-" + purpose_ + "-" + proton::uuid::random().str());
  options.idle_timeout(to_proton(2 * options_.heartbeat));
  options.max_frame_size(largest_frame);
  options.sasl_enabled(true);
  options.sasl_allow_insecure_mechs(true);  // PLAIN without TLS: what the URL asks for
  if (credentials.user.empty()) {
    options.sasl_allowed_mechs("ANONYMOUS");
  } else {
    options.sasl_allowed_mechs("PLAIN");
    options.user(credentials.user);
    options.password(credentials.password);
  }
  if (is_tls(url)) {
    const Tls& tls = options_.tls;
    const std::string authorities = tls.ca_file.empty() ? system_authorities : tls.ca_file;
    options.ssl_client_options(
        tls.certificate_file.empty()
            ? proton::ssl_client_options(authorities, proton::ssl::VERIFY_PEER_NAME)
            : proton::ssl_client_options(proton::ssl_certificate(tls.certificate_file, tls.key_file), authorities,
                                         proton::ssl::VERIFY_PEER_NAME));
    options.virtual_host(url.host);
  }
  return options;
}

void ServerLink::attempt(std::size_t server) {
  server_ = server;
  trouble_.clear();
  blamed_ = false;
  try {
    proton::connection_options options = connection_options(urls_[server]);
    options.handler(*this);
    proton::connection connection = container_.connect(proton_url(urls_[server]), options);
    const Lock lock(mutex_);
    connection_ = connection;
    if (closing_) connection_.close();
  } catch (const std::exception& error) {  // a password file that is not there, a certificate that cannot be read
    log_.failed(error.what());
    servers_.failed(server, now());
    return;
  }
  phase_ = Phase::connecting;
  attempt_ends_ = now() + options_.rpc_timeout;
}

void ServerLink::on_connection_open(proton::connection& connection) {
  if (connection != connection_) return;
  guarded([this] { greet(); });
}

void ServerLink::greet() {
  phase_ = Phase::greeting;
  proton::sender_options sending;
  sending.target(proton::target_options().anonymous(true));  // each message says where it goes
  sender_ = connection_.open_sender("", sending);
  proton::receiver_options receiving;
  receiving.source(proton::source_options().dynamic(true)).credit_window(1000);
  answers_ = connection_.open_receiver("", receiving);
}

void ServerLink::on_receiver_open(proton::receiver& receiver) {
  if (receiver.connection() != connection_) return;
  if (receiver != answers_) {
    guarded([&] { on_other_receiver_open(receiver); });
    return;
  }
  answers_address_ = receiver.source().address();
  // Nobody answers when the server has no statistics; it must not make a queue for the question.
  guarded([this] {
    ask("", [this](const std::vector<QueueFacts>&) {
      phase_ = Phase::up;
      servers_.connected(server_, now());
      log_.connected();
      {
        const Lock lock(mutex_);
        connected_ = true;
      }
      up();
      run_serve();
    });
  });
}

void ServerLink::ask(const std::string& queues, Answer answer) {
  const std::uint64_t number = ++last_question_;
  questions_.emplace(number, Question{{}, std::move(answer), now()});
  sender_.send(statistics_question(queues, answers_address_, number));
}

void ServerLink::on_message(proton::delivery& delivery, proton::message& message) {
  if (delivery.connection() != connection_) return;
  if (delivery.receiver() == answers_) {
    guarded([&] { answered(message); });
  } else {
    guarded([&] { on_other_message(delivery, message); });
  }
}

void ServerLink::answered(const proton::message& message) {
  const StatisticsAnswer answer = statistics_answer(message);
  const auto found = questions_.find(answer.question);
  if (found == questions_.end()) return;
  if (answer.facts) {
    found->second.facts.push_back(*answer.facts);
    return;
  }
  const Question question = std::move(found->second);
  questions_.erase(found);
  question.answer(question.facts);
}

void ServerLink::abandon(const std::string& why) {
  if (phase_ == Phase::away) return;
  if (trouble_.empty()) trouble_ = why;
  connection_.close();
  connection_.wake();  // or a close from a timer would not be sent
  lost(trouble_);
}

void ServerLink::on_connection_error(proton::connection& connection) {
  if (connection != connection_) return;
  trouble_ = describe(connection.error());
  blamed_ = connection.error().name() != "amqp:connection:forced";
}

void ServerLink::on_transport_error(proton::transport& transport) {
  if (transport.connection() != connection_ || !trouble_.empty()) return;
  trouble_ = describe(transport.error());
}

void ServerLink::on_transport_close(proton::transport& transport) {
  if (transport.connection() != connection_) return;
  lost(trouble_.empty() ? "the server closed it" : trouble_);
}

void ServerLink::on_receiver_error(proton::receiver& receiver) {
  if (receiver.connection() != connection_) return;
  if (receiver == answers_) {
    abandon("it gives no answers about its queues: " + describe(receiver.error()));
  } else {
    guarded([&] { on_other_receiver_error(receiver); });
  }
}

void ServerLink::on_session_error(proton::session& session) {
  if (session.connection() != connection_) return;
  if (session == sender_.session()) {
    abandon(describe(session.error()));
  } else {
    guarded([&] { on_other_session_error(session); });
  }
}

void ServerLink::on_sender_error(proton::sender& sender) {
  if (sender.connection() != connection_) return;
  trouble_ = describe(sender.error());
  blamed_ = true;
  abandon(trouble_);
}

void ServerLink::on_error(const proton::error_condition&) {}  // by default it throws through the I/O thread

void ServerLink::on_connection_wake(proton::connection& connection) {
  if (connection != connection_) return;
  bool closing = false;
  {
    const Lock lock(mutex_);
    closing = closing_;
  }
  if (closing) {
    guarded([this] { finish(); });
  } else {
    run_serve();
  }
}

void ServerLink::lost(const std::string& why) {
  const Phase was = std::exchange(phase_, Phase::away);
  if (was == Phase::up && blamed_ && under_way() == 1) blame(why);
  sender_ = {};
  answers_ = {};
  questions_.clear();
  down();
  bool closing = false;
  {
    const Lock lock(mutex_);
    connection_ = {};
    connected_ = false;
    woken_ = false;
    closing = closing_;
    changed_.notify_all();
  }
  if (closing) return;
  if (was != Phase::up) {
    log_.failed(why);
    servers_.failed(server_, now());
  } else if (std::exchange(moving_back_, false)) {
    logger.info("{}: going back to the preferred server", purpose_);
    servers_.left();
  } else {
    log_.lost(why);
    servers_.lost(now());
  }
  run_serve();
}

}  // namespace iotcloud::brokers::activemq
