#include <thread>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/rpc/peer_user.h>
#include <iotcloud/rpc/session.h>
#include <iotcloud/security/logger.h>

namespace iotcloud::rpc {

namespace {

/// The role of a client where no token is needed: only root, the daemon's own user and the named accounts may order;
/// others, such as drivers under another account, may read.
security::Role role_without_token(const AccessOptions& options, const ThriftPeer& peer) {
  const auto user = peer.user();
  return options.open || (user && is_trusted_user(*user, options.users)) ? security::Role::admin
                                                                         : security::Role::viewer;
}

}  // namespace

CallerSession::CallerSession(const AccessOptions& options, std::shared_ptr<ThriftPeer> peer)
    : options_(options), peer_(std::move(peer)), local_role_(role_without_token(options_, *peer_)) {
  if (options_.tokens && peer_->vouched()) {
    holder_ = peer_->vouched();
    peer_->set_identity(holder_->name);
  } else if (options_.tokens) {
    peer_->ask_who_it_is();
  } else if (peer_->user()) {
    peer_->set_identity(caller());
  }
}

security::Role CallerSession::role() const {
  if (!options_.tokens) return local_role_;
  if (!holder_) return security::Role::anyone;
  return options_.tokens->role_of(*holder_).value_or(security::Role::anyone);
}

/// The caller's name for people.
std::string CallerSession::caller() const {
  if (holder_) return holder_->name;
  if (options_.tokens) return "";
  return peer_->user() ? fmt::format("user {}", *peer_->user()) : "";
}

/// Who shares the limits of those that have not said who they are: the holders of one certificate, the processes of one
/// user, or what comes from one host.
std::string CallerSession::stranger() const {
  if (!peer_->certificate().empty()) return peer_->certificate();
  return peer_->user() ? fmt::format("user {}", *peer_->user()) : peer_->identity();
}

security::AuditEntry CallerSession::entry(const std::string& method) const {
  security::AuditEntry entry;
  entry.who = caller();
  entry.role = to_string(role());
  entry.certificate = peer_->certificate();
  entry.address = peer_->address();
  entry.order = method;
  return entry;
}

/// Writes a refusal into the logs, each within its limit: a flood of refused calls fills no disk.
void CallerSession::tell_refusal(const std::string& method, const std::string& kind, const std::string& text) {
  options_.refusals->refused(kind + " " + method, fmt::format("{}: {} of {} is refused: {}", options_.service, method,
                                                              peer_->address(), text));
  if (!options_.audit) return;
  auto line = entry(method);
  line.outcome = text;
  options_.audit->write_refused(std::move(line));
}

/// Logs and counts that a token was refused. \return the text
std::string CallerSession::refuse_token(const std::string& kind, std::string text) {
  count_refusal(options_.service, kind);
  tell_refusal("authenticate", kind, text);
  return text;
}

std::string CallerSession::authenticate(const std::string& token) {
  if (!options_.tokens) return "";
  std::shared_ptr<void> turn;
  if (options_.tokens->costs(token)) {
    turn = options_.token_tries->enter(stranger());
    // While it waited, another connection may have shown the same token.
    if (!turn && options_.tokens->costs(token))
      return refuse_token("token_rate", fmt::format("{} tries too many tokens; try again later", stranger()));
  }
  std::string why;
  holder_ = options_.tokens->holder(token, peer_->certificate(), &why);
  turn.reset();  // the pause after a wrong token holds up no other try
  if (holder_) {
    peer_->set_identity(holder_->name);
    peer_->set_validity([tokens = options_.tokens, holder = *holder_] { return tokens->role_of(holder).has_value(); });
    if (role() == security::Role::admin || role() == security::Role::master) {  // masters pass on plugins
      peer_->trust();
    } else {
      peer_->trust(options_.most_bytes);
    }
    security::access_logger.info("{}: {} is {} ({})", options_.service, peer_->address(), holder_->name,
                                 to_string(role()));
    return "";
  }
  refuse_token("token", why.empty() ? "a token that is nobody's" : why);
  if (++wrong_tokens_ >= options_.wrong_tokens) peer_->hang_up();
  std::this_thread::sleep_for(options_.wrong_token_pause);
  if (!why.empty()) return why;
  return "that is nobody's token here, or it counts only with another certificate; `iotcloud token list` shows whose "
         "there are, and with which certificate each counts";
}

void CallerSession::begins(std::string what) {
  what_ = std::move(what);
  if (!audited_ || !options_.audit) return;
  auto line = entry(method_);
  line.what = what_;
  options_.audit->write_begun(std::move(line));
}

void CallerSession::note(std::string outcome) {
  outcome_ = std::move(outcome);
}

std::optional<CallerSession::Refusal> CallerSession::refuse(const std::string& method, security::Role has) {
  const auto rule = options_.rules.find(method);
  if (rule == options_.rules.end()) {
    count_refusal(options_.service, "method");
    audited_ = false;
    return Refusal{fmt::format("this service has no method {} for anybody", method), 0, RefusalForm::failure, true};
  }
  const security::Role wanted = rule->second.role;
  if (has == security::Role::master && rule->second.for_master) return std::nullopt;
  if (has >= wanted) return std::nullopt;
  Refusal refusal;
  refusal.form = rule->second.form;
  const bool stranger = has == security::Role::anyone;
  if (stranger) {
    refusal.code = options_.not_authenticated;
    refusal.text = holder_ ? fmt::format("the token of {} was taken away, or has expired", holder_->name)
                           : "this service asks for a token: call authenticate(token) first on this connection; "
                             "the program iotcloud does with --token-file FILE or the environment variable "
                             "IOTCLOUD_TOKEN";
  } else {
    refusal.code = options_.not_allowed;
    refusal.text = fmt::format("{} is {}, and {} takes {}", holder_ ? holder_->name : "this user of the machine",
                               to_string(has), method, to_string(wanted));
    if (!holder_) refusal.text += "; be root or the daemon's own user, or let the configuration name it (users)";
  }
  const char* const kind = stranger ? "not_authenticated" : "role";
  count_refusal(options_.service, kind);
  audited_ = false;  // when giveOrder asks again for the kind of order, the line of this refusal is to be the only one
  if (stranger && std::exchange(told_, true)) return refusal;
  tell_refusal(method, kind, refusal.text);
  return refusal;
}

/// Waits for the turn of a call.
std::optional<CallerSession::Refusal> CallerSession::refuse_too_many(const std::string& method, security::Role has) {
  const std::string who = has == security::Role::anyone ? stranger() : caller();
  auto turn = options_.limits->enter(has, who);
  if (!turn) {
    count_refusal(options_.service, "rate");
    options_.refusals->refused("rate", fmt::format("{}: {} of {} is refused: {} makes too many calls", options_.service,
                                                   method, peer_->address(), who));
    const auto rule = options_.rules.find(method);
    return Refusal{fmt::format("{} makes too many calls; try again later", who), options_.not_allowed,
                   rule == options_.rules.end() ? RefusalForm::failure : rule->second.form};
  }
  peer_->hold(std::move(turn));
  return std::nullopt;
}

void CallerSession::begin(const std::string& method) {
  const auto rule = options_.rules.find(method);
  method_ = method;
  audited_ = rule != options_.rules.end() && rule->second.role >= security::Role::operating && rule->second.audited;
  what_.clear();
  outcome_ = "answered";
}

void CallerSession::end() {
  if (!audited_) return;
  auto line = entry(method_);
  line.what = what_;
  line.outcome = outcome_;
  security::access_logger.info("{}: {} ({}, {}) ordered {} {}: {}", options_.service,
                               line.who.empty() ? "somebody" : line.who, line.role, line.address, method_, line.what,
                               line.outcome);
  if (options_.audit) options_.audit->write(line);
}

}  // namespace iotcloud::rpc
