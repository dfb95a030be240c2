#include <thread>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/rpc/session.h>
#include <iotcloud/security/logger.h>

namespace iotcloud::rpc {

Session::Session(const AccessOptions& options, std::shared_ptr<ThriftPeer> peer)
    : options_(options), peer_(std::move(peer)) {
  if (options_.tokens) peer_->ask_who_it_is();
}

security::Role Session::role() const {
  if (!options_.tokens) return security::Role::admin;
  if (!holder_) return security::Role::anyone;
  return options_.tokens->role_of(*holder_).value_or(security::Role::anyone);
}

security::AuditEntry Session::entry(const std::string& method) const {
  security::AuditEntry entry;
  entry.who = holder_ ? holder_->name : "";
  entry.role = to_string(role());
  entry.certificate = peer_->certificate();
  entry.address = peer_->address();
  entry.order = method;
  return entry;
}

std::string Session::authenticate(const std::string& token) {
  if (!options_.tokens) return "";
  holder_ = options_.tokens->holder(token, peer_->certificate());
  if (holder_) {
    peer_->trust();
    security::access_logger.info("{}: {} is {} ({})", options_.service, peer_->address(), holder_->name,
                                 to_string(role()));
    return "";
  }
  count_refusal(options_.service, "token");
  security::access_logger.warn("{}: {} shows a token that is nobody's", options_.service, peer_->address());
  if (options_.audit) {
    auto line = entry("authenticate");
    line.outcome = "a token that is nobody's";
    line.refused = true;
    options_.audit->write(line);
  }
  if (++wrong_tokens_ >= options_.wrong_tokens) peer_->hang_up();
  std::this_thread::sleep_for(options_.wrong_token_pause);
  return "that is nobody's token here, or it counts only with another certificate; `iotcloud token list` shows whose "
         "there are, and with which certificate each counts";
}

void Session::note(std::string what, std::string outcome) {
  what_ = std::move(what);
  outcome_ = std::move(outcome);
}

std::optional<Session::Refusal> Session::refuse(const std::string& method) {
  const auto rule = options_.rules.find(method);
  if (rule == options_.rules.end()) {
    count_refusal(options_.service, "method");
    return Refusal{fmt::format("this service has no method {} for anybody", method), 0, RefusalForm::failure, true};
  }
  const security::Role wanted = rule->second.role;
  const security::Role has = role();
  if (has >= wanted || (has == security::Role::master && rule->second.for_master)) return std::nullopt;
  Refusal refusal;
  refusal.form = rule->second.form;
  const bool stranger = has == security::Role::anyone;
  if (stranger) {
    refusal.code = options_.not_authenticated;
    refusal.text = holder_ ? fmt::format("the token of {} was taken away", holder_->name)
                           : "this service asks for a token: call authenticate(token) first on this connection; "
                             "the program iotcloud does with --token-file FILE or the environment variable "
                             "IOTCLOUD_TOKEN";
  } else {
    refusal.code = options_.not_allowed;
    refusal.text = fmt::format("{} is {}, and {} takes {}", holder_->name, to_string(has), method, to_string(wanted));
  }
  count_refusal(options_.service, stranger ? "not_authenticated" : "role");
  if (stranger && std::exchange(told_, true)) return refusal;
  security::access_logger.warn("{}: {} of {} is refused: {}", options_.service, method, peer_->address(), refusal.text);
  if (options_.audit) {
    auto line = entry(method);
    line.outcome = refusal.text;
    line.refused = true;
    options_.audit->write(line);
  }
  return refusal;
}

void Session::begin() {
  what_.clear();
  outcome_ = "answered";
}

void Session::end(const std::string& method) {
  const auto rule = options_.rules.find(method);
  if (rule == options_.rules.end() || rule->second.role < security::Role::operating || !rule->second.audited) return;
  auto line = entry(method);
  line.what = what_;
  line.outcome = outcome_;
  security::access_logger.info("{}: {} ({}, {}) ordered {} {}: {}", options_.service,
                               line.who.empty() ? "somebody" : line.who, line.role, line.address, method, line.what,
                               line.outcome);
  if (options_.audit) options_.audit->write(line);
}

}  // namespace iotcloud::rpc
