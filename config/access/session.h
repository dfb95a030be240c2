#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include <iotcloud/config/access/audit_log.h>
#include <iotcloud/config/access/tokens.h>
#include <iotcloud/config/thrift/thrift_server.h>

namespace iotcloud::config {

/// How a method of a Thrift service says that it was refused.
enum class RefusalForm {
  failure,   ///< the call fails, with the reason (TApplicationException)
  response,  ///< its result is a TResponse (discovery/records.thrift)
  order,     ///< its result has a TResponse as field 1 and says in field 3 why it was refused (AccessOptions)
  error,     ///< it throws the exception that is its field 1, whose field 1 is the reason
};

/// What a method asks of those who call it.
struct MethodRule {
  Role role = Role::admin;
  RefusalForm form = RefusalForm::failure;
  /// Orders (what viewers may not) are in the audit log; not those that are parts of one, and would fill it.
  bool audited = true;
};
/// Of every method of a service by its name. One that is not here is unknown to everybody: a new one states its role.
using MethodRules = std::map<std::string, MethodRule, std::less<>>;

/// Who may do what with one service.
struct AccessOptions {
  std::string service;  ///< as ThriftServerOptions::name
  MethodRules rules;
  std::shared_ptr<TokenKeeper> tokens;  ///< null: nobody is asked for one, everybody may do everything
  std::shared_ptr<AuditLog> audit;      ///< null: orders are in the usual log only
  /// RefusalForm::order: the numbers for who has shown no token, and for who may not do this.
  int not_authenticated = 0;
  int not_allowed = 0;
  /// How long the answer to a wrong token is held back; after so many of them the connection is closed.
  std::chrono::milliseconds wrong_token_pause{1'000};
  int wrong_tokens = 3;
};

/// One connection: who speaks, and what became of the call under way. Used by the connection's thread.
class Session {
 public:
  /// \param options outlive it.
  Session(const AccessOptions& options, std::shared_ptr<ThriftPeer> peer);

  /// What a service's authenticate() does. \return why not; empty: the connection is open.
  std::string authenticate(const std::string& token);

  /// What the caller may do now.
  Role role() const;

  /// For the audit log, of the call under way: what it is about, and what became of it.
  void note(std::string what, std::string outcome);

 private:
  friend class GuardedProcessor;
  /// What is refused, and the number that says so in RefusalForm::order.
  struct Refusal {
    std::string text;
    int code = 0;
    RefusalForm form = RefusalForm::failure;
    bool unknown = false;  ///< there is no rule for the method
  };
  std::optional<Refusal> refuse(const std::string& method);
  void begin();
  void end(const std::string& method);
  AuditEntry entry(const std::string& method) const;

  const AccessOptions& options_;
  const std::shared_ptr<ThriftPeer> peer_;
  std::optional<TokenEntry> holder_;
  int wrong_tokens_ = 0;
  bool told_ = false;  ///< that a stranger calls is logged once
  std::string what_;
  std::string outcome_;
};

/// A processor that lets only those calls through that the session may make, and writes down the orders.
std::shared_ptr<apache::thrift::TProcessor> guarded(std::shared_ptr<apache::thrift::TProcessor> processor,
                                                    std::shared_ptr<Session> session);

}  // namespace iotcloud::config
