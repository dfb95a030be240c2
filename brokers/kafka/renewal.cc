#include "iotcloud/brokers/kafka/renewal.h"

#include <algorithm>
#include <exception>
#include <fstream>
#include <iterator>
#include <string_view>
#include <utility>

#include <iotcloud/brokers/kafka/logger.h>

namespace iotcloud::brokers::kafka {
namespace {

/// The certificates in a file of PEM, each as the text between its first and last line.
std::set<std::string> certificates_in(const std::string& path) {
  constexpr std::string_view first = "-----BEGIN CERTIFICATE-----", last = "-----END CERTIFICATE-----";
  std::ifstream file(path);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  std::set<std::string> found;
  std::size_t end = 0;
  for (auto begin = text.find(first); begin != std::string::npos; begin = text.find(first, end)) {
    end = std::min(text.find(last, begin), text.size());
    found.insert(text.substr(begin, end - begin));
  }
  return found;
}

}  // namespace

Renewal::Renewal(const KafkaOptions& options, Make make) : options_(options), make_(std::move(make)) {}

std::shared_ptr<KafkaClient> Renewal::client() {
  if (next_ && next_may_take_over()) {
    logger.info("{}: a client with the renewed TLS files takes over", printable_url(options_.broker.urls.front()));
    used_ = std::exchange(of_next_, {});
    return std::exchange(next_, nullptr);
  }
  next_.reset();
  seen_ = mark();
  used_ = files(seen_);  // before the library reads them: a change meanwhile is noticed
  return make_();
}

bool Renewal::ready(Instant now) {
  if (!is_secured(options_)) return false;
  if (now >= look_at_) {
    look_at_ = now + look_period;
    look();
  }
  if (!next_) return false;
  serve_events();
  return next_may_take_over();
}

bool Renewal::next_may_take_over() const {
  const bool trusts_fewer = !std::ranges::includes(of_next_.authorities, used_.authorities);
  return next_->connected() || of_next_.mark.back() != used_.mark.back() || trusts_fewer;
}

Renewal::Mark Renewal::mark() const {
  const Tls& files = options_.broker.tls;
  return {config::stamp_of(files.ca_file), config::stamp_of(files.certificate_file), config::stamp_of(files.key_file),
          config::stamp_of(files.revoked_file)};
}

Renewal::Files Renewal::files(const Mark& mark) const {
  return {mark, certificates_in(options_.broker.tls.ca_file)};
}

void Renewal::look() {
  const Mark now = mark();
  const bool settled = std::exchange(seen_, now) == now;
  if (!settled) complaints_.clear();
  if (now == used_.mark) {
    next_.reset();
  } else if (settled && (!next_ || of_next_.mark != now)) {
    make_next(now);
  }
}

void Renewal::make_next(const Mark& mark) {
  next_.reset();
  try {
    Files read = files(mark);
    next_ = make_();
    of_next_ = std::move(read);
  } catch (const std::exception& error) {  // ClientError, config::Error: the next look tries again
    complain(error.what());
  }
}

/// Says why servers refuse the new files. What else fails is said by the present client, too.
void Renewal::serve_events() {
  const Queue events(rd_kafka_queue_get_main(next_->get()));
  while (const Event event{rd_kafka_queue_poll(events.get(), 0)}) {
    if (rd_kafka_event_type(event.get()) != RD_KAFKA_EVENT_ERROR) continue;
    // A server that refuses the client's certificate ends the connection, which is an error of the transport.
    const std::string why = lasting_words(event.get());
    const bool refused = rd_kafka_event_error(event.get()) == RD_KAFKA_RESP_ERR__AUTHENTICATION;
    if (refused || why.find("SSL") != std::string::npos) complain(why);
  }
}

void Renewal::complain(const std::string& why) {
  if (!complaints_.insert(why).second) return;
  logger.warn(
      "{}: the renewed TLS files (tls.ca, tls.certificate, tls.key, tls.revoked) are of no use yet: {}; going on with "
      "those from before",
      printable_url(options_.broker.urls.front()), why);
}

}  // namespace iotcloud::brokers::kafka
