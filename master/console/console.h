#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/master/console/console_calls.h>
#include <iotcloud/master/console/console_settings.h>
#include <iotcloud/master/console/live.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::master {

/// The console: a page that shows the fleet live, and by which people act. Serves from construction to destruction.
/// Thread safe.
class Console {
 public:
  struct Options {
    ConsoleSettings settings;
    std::string id;                                 ///< the master's, which the page shows
    std::shared_ptr<security::TokenKeeper> tokens;  ///< the API's; null: no log-in, and the browser's user counts
    std::vector<std::string> users{};               ///< as rpc::ListenSettings::users
    bool open = false;                              ///< as rpc::ListenSettings::open
    std::string audit_file{};                       ///< of the audit log; empty: there is none to show
    Live::Options live{};
  };
  /// \param source what it shows, and \param calls what people ask and order; both outlive the console.
  /// \throws config::Error when the address cannot be bound
  Console(Options options, Live::Source source, ConsoleCalls& calls);
  /// Waits until no request is worked on; end what orders wait for before.
  ~Console();
  Console(const Console&) = delete;
  Console& operator=(const Console&) = delete;

  std::string address() const;  ///< "host:port" with the real port
  std::string url() const;      ///< "https://host:port/"
  /// Reads the certificates again. \throws config::Error that names an unusable file, which counts as it was
  void reload();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
