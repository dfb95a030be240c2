#pragma once

#include <chrono>
#include <deque>
#include <iosfwd>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/output.h>
#include <iotcloud/security/tokens.h>

namespace CLI {
class App;
}

namespace iotcloud::master::cli {

/// The program's exit statuses, on which scripts may rely.
enum ExitStatus {
  exit_ok = 0,
  exit_failed = 1,       ///< the order failed, for all or for some; or the master could not answer
  exit_usage = 2,        ///< the command line is wrong, or the beginning of an id fits several
  exit_unreachable = 3,  ///< no master answers
  exit_differs = 4,      ///< diff, apply --dry-run: the fleet is not as the manifest says
};

/// One call of the program: what all verbs share.
struct Call {
  std::ostream& out;  ///< results
  std::ostream& err;  ///< error messages
  std::vector<std::string> masters{"127.0.0.1:12904"};
  MasterAccess access{};
  Format format = Format::table;
  bool progress = false;  ///< show the progress of sending a plugin on `err`, which is a terminal
  /// How long an order is tried again while no master leads: longer than an election takes after a leader died.
  std::chrono::milliseconds election_patience{20'000};

  /// Makes another connection to the masters. \throws std::invalid_argument for an invalid address.
  std::unique_ptr<MasterClient> connect() const;
};

/// One verb of the command line: its options, their completion, the role that it requires, and what it does. An object
/// is used once, because the command line's values are in its members.
class Verb {
 public:
  /// The verb's text in the help.
  struct Card {
    const char* name;
    const char* what;
    const char* example;
    /// The least role that a master requires of the token. nullopt: the verb asks no master.
    std::optional<security::Role> role;
    bool answers = true;  ///< it prints data in the format that --output chooses; false: it prints text
  };
  explicit Verb(const Card& of) : card(of) {}
  virtual ~Verb() = default;
  Verb(const Verb&) = delete;
  Verb& operator=(const Verb&) = delete;

  const Card card;

  /// Adds its options. The name of an option's type decides how its value is completed (completion.cc).
  virtual void declare(CLI::App& options) = 0;
  /// Checks what the options cannot check one by one. \throws CLI::ParseError
  virtual void check() {}
  /// Whether the verb runs until interrupt() is called.
  virtual bool goes_on() const { return false; }
  /// \return the exit status. \throws the exceptions for which run() in program.cc has an exit status.
  virtual int run(Call& call) = 0;
};

/// Prints the gateways that did not answer. \param what they should have told: "the history"
/// \return the exit status: exit_failed if there are any
int name_silent(const std::map<discovery::GatewayId, std::string>& silent, std::string_view what, std::ostream& err);

/// The verbs of the program, or those of a group of them ("topology").
class Verbs {
 public:
  Verbs(CLI::App& app, Format& format) : app_(app), format_(format) {}
  ~Verbs();

  template <typename OfVerb, typename... Arguments>
  void add(Arguments&&... arguments) {
    add(std::make_unique<OfVerb>(std::forward<Arguments>(arguments)...));
  }
  void add(std::unique_ptr<Verb> verb);
  Verbs& group(const char* name, const char* what);

  /// The verb that the command line names; nullptr: none.
  Verb* chosen() const;
  /// All verbs, also those of groups.
  std::vector<const Verb*> all() const;

 private:
  CLI::App& app_;
  Format& format_;
  std::vector<std::pair<CLI::App*, std::unique_ptr<Verb>>> verbs_;
  std::deque<Verbs> groups_;
};

// The families of verbs, each in a file of that or a similar name. `families` has them in the order of the help.
void add_gateway_verbs(Verbs& verbs);
void add_driver_verbs(Verbs& verbs);
void add_history_verbs(Verbs& verbs);
void add_event_verbs(Verbs& verbs);
void add_status_verbs(Verbs& verbs);
void add_order_verbs(Verbs& verbs);
void add_fleet_verbs(Verbs& verbs);
void add_drain_verbs(Verbs& verbs);
void add_registry_verbs(Verbs& verbs);
void add_channel_verbs(Verbs& verbs);
void add_topology_verbs(Verbs& verbs);
void add_run_verbs(Verbs& verbs);
void add_recording_verbs(Verbs& verbs);
void add_new_verbs(Verbs& verbs);
void add_check_verbs(Verbs& verbs);
void add_plugin_verbs(Verbs& verbs);
void add_signing_verbs(Verbs& verbs);
void add_security_verbs(Verbs& verbs);
void add_completion_verbs(Verbs& verbs);
inline constexpr auto families = {add_gateway_verbs,   add_driver_verbs,   add_history_verbs,   add_event_verbs,
                                  add_status_verbs,    add_order_verbs,    add_fleet_verbs,     add_drain_verbs,
                                  add_registry_verbs,  add_channel_verbs,  add_topology_verbs,  add_run_verbs,
                                  add_recording_verbs, add_new_verbs,      add_check_verbs,     add_plugin_verbs,
                                  add_signing_verbs,   add_security_verbs, add_completion_verbs};

}  // namespace iotcloud::master::cli
