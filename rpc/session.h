#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/rpc/call_limits.h>
#include <iotcloud/rpc/refusal_log.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/audit_log.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::rpc {

/// How a method of a Thrift service answers a refused call.
enum class RefusalForm {
  failure,   ///< the call fails with the reason (TApplicationException)
  response,  ///< the result is a TResponse (discovery/records.thrift) with the reason
  order,     ///< the result has a TResponse as field 1, and in field 3 the code of the reason (AccessOptions)
  error,     ///< the method throws the exception of its field 1, whose own field 1 is the reason
};

/// The role that a method asks of its caller, and its answer to others.
struct MethodRule {
  security::Role role = security::Role::admin;
  RefusalForm form = RefusalForm::failure;
  /// Orders (calls that viewers may not make) are in the audit log, except parts of an order, which would fill it.
  bool audited = true;
  bool for_master = false;  ///< Role::master may call it too, whatever `role` says
};
/// The rule of every method of a service by its name. Nobody may call a method without a rule, so a new one must state
/// its role.
using MethodRules = std::map<std::string, MethodRule, std::less<>>;

/// The access rules of one service.
struct AccessOptions {
  std::string service;  ///< the same as ThriftServerOptions::name
  MethodRules rules;
  /// null: clients need no token. Then root, the daemon's own user and `users` may do everything, and others read.
  std::shared_ptr<security::TokenKeeper> tokens;
  std::vector<std::string> users;             ///< without tokens: more accounts of this machine that may do everything
  bool open = false;                          ///< without tokens: everybody may do everything
  std::shared_ptr<security::AuditLog> audit;  ///< null: orders are in the ordinary log only
  /// The ordinary log of refused calls.
  std::shared_ptr<RefusalLog> refusals = std::make_shared<RefusalLog>(config::Logger{"access"});
  /// How many calls each identity may make; those that are refused count too.
  std::shared_ptr<RoleLimits> limits = std::make_shared<RoleLimits>();
  /// How many tokens each caller may try that take a hash.
  std::shared_ptr<CallLimits> token_tries =
      std::make_shared<CallLimits>(usual_token_tries(std::chrono::milliseconds{2'000}));
  /// The largest message of a viewer and an operator, who send no plugins.
  int most_bytes = 1 << 20;
  /// RefusalForm::order: the codes for a client without a token, and for one whose role does not allow the call.
  int not_authenticated = 0;
  int not_allowed = 0;
  /// How long the answer to a wrong token is delayed; after `wrong_tokens` of them the connection is closed.
  std::chrono::milliseconds wrong_token_pause{1'000};
  int wrong_tokens = 3;
};

/// One connection: its user, and the outcome of its current call. Used by the connection's thread.
class CallerSession {
 public:
  /// \param options must outlive the session.
  CallerSession(const AccessOptions& options, std::shared_ptr<ThriftPeer> peer);

  /// Implements a service's authenticate(). \return why it failed; empty: the session is open.
  std::string authenticate(const std::string& token);

  /// The caller's current role.
  security::Role role() const;

  /// Writes into the audit log that the current call's order is about to be carried out. Every audited method calls it
  /// before its effect. \param what what the order is about, in words
  /// \throws config::Error if the order must not be carried out, because that cannot be written
  void begins(std::string what);
  /// Notes for the audit log the outcome of the current call.
  void note(std::string outcome);

  /// Why a call is refused, and the code that says so in RefusalForm::order.
  struct Refusal {
    std::string text;
    int code = 0;
    RefusalForm form = RefusalForm::failure;
    bool unknown = false;  ///< the method has no rule
  };
  /// Whether the caller may call the method of that name; logs and counts a refusal. The guarded processor asks before
  /// every call. A method that takes several kinds of orders asks again, for the kind.
  std::optional<Refusal> refuse(const std::string& method) { return refuse(method, role()); }

 private:
  friend class GuardedProcessor;
  void begin(const std::string& method);
  void end();
  std::string caller() const;
  std::string stranger() const;
  std::string refuse_token(const std::string& kind, std::string text);
  security::AuditEntry entry(const std::string& method) const;
  /// \param has the caller's current role
  std::optional<Refusal> refuse(const std::string& method, security::Role has);
  std::optional<Refusal> refuse_too_many(const std::string& method, security::Role has);
  void tell_refusal(const std::string& method, const std::string& kind, const std::string& text);

  const AccessOptions& options_;
  const std::shared_ptr<ThriftPeer> peer_;
  const security::Role local_role_;  ///< without tokens
  std::optional<security::TokenEntry> holder_;
  int wrong_tokens_ = 0;
  bool told_ = false;     ///< the first call without a token was logged
  std::string method_;    ///< of the current call
  bool audited_ = false;  ///< the current call is an order that is written down
  std::string what_;
  std::string outcome_;
};

/// A processor that passes on only the calls that the session may make, and writes orders to the audit log.
std::shared_ptr<apache::thrift::TProcessor> guarded(std::shared_ptr<apache::thrift::TProcessor> processor,
                                                    std::shared_ptr<CallerSession> session);

}  // namespace iotcloud::rpc
