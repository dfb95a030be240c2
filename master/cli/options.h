#pragma once

#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/master/cli/master_client.h>

namespace CLI {
class App;
class Option;
}  // namespace CLI

/// Options that several verbs share.
namespace iotcloud::master::cli {

/// The command line is ambiguous: the beginning of an id fits several instances.
class AmbiguousId : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Puts words of the form "k=v" into a map. \throws CLI::ValidationError
std::map<std::string, std::string> pairs(const std::vector<std::string>& words, const char* option);

/// Adds an option that takes a number of seconds from `least` to `longest`.
CLI::Option& add_seconds(CLI::App& options, const char* name, std::chrono::milliseconds& into, double least,
                         double longest, const char* what);
/// -g lab1,lab2 or -g lab1 -g lab2. A verb without ids may let its option take several words: -g lab1 lab2.
CLI::Option& add_gateways(CLI::App& options, std::vector<discovery::GatewayId>& gateways, const char* what);
void add_wait(CLI::App& options, WaitLimit& wait, const char* name = "--wait",
              const char* what = "seconds to wait for the outcome; the master decides when it is not given");
/// For verbs that update drivers step by step.
void add_settle(CLI::App& options, std::chrono::milliseconds& settle);
CLI::Option& add_plugin(CLI::App& options, std::string& plugin);

/// The bytes of a file that the command line names. \throws config::Error when it cannot be read.
std::string bytes_of(const std::string& path);

/// Which driver instances a verb is for: those with some ids, or those that meet all conditions that are given.
struct InstanceChoice {
  std::vector<std::string> instances;          ///< ids, or beginnings of ids
  std::vector<discovery::GatewayId> gateways;  ///< on these only
  discovery::DriverName driver;                ///< only of this driver
  std::string name, state;                     ///< only of the deployment of this name, in this state
  std::string where;                           ///< only those for which this expression holds
  bool all = false;  ///< for orders: the command line says explicitly that the order is for all

  void add_ids(CLI::App& options, const char* what);
  void add_what_they_are(CLI::App& options, const char* gateways_what);
  /// Checks that an order has ids or conditions; it is for all instances only when the command line says so.
  /// \throws CLI::ParseError
  void check_order() const;

  /// The same choice where `-g lab1 lab2` was given, of which the parser takes the second gateway for an instance. An
  /// order asks for its ids() and gateways. \throws RequestFailed when there are conditions and a word that is no
  /// gateway; Unreachable
  InstanceChoice with_all_gateways(MasterClient& master) const;
  /// The records of the chosen instances, sorted by driver, gateway and id.
  /// \throws std::invalid_argument for a wrong `where`, before a master is asked; Unreachable, RequestFailed
  std::vector<discovery::DriverRecord> drivers(MasterClient& master) const;
  /// The full ids of the chosen instances, with those that are ordered and that their gateways have not taken up yet
  /// (their state is `ordered`). An id that no record begins with is kept as it is, because its gateway may
  /// not have followed its order yet.
  /// \throws AmbiguousId; RequestFailed, also when no instance fits; and what drivers() throws
  std::vector<discovery::InstanceId> ids(MasterClient& master) const;

 private:
  bool has_conditions() const;
  std::vector<discovery::DriverRecord> chosen(std::vector<discovery::DriverRecord> drivers,
                                              const discovery::Selection& selection) const;
};

/// The record of the instance with this name ("meter/2", or "meter" if it is the only one), or with the id that begins
/// with this text. \throws AmbiguousId, Unreachable; RequestFailed, also when there is no record.
discovery::DriverRecord driver_of(const std::string& word, MasterClient& master);
/// The words, with the ids of present instances in place of names; ids, and beginnings of ids, stay as they are.
std::vector<std::string> ids_of_names(const std::vector<std::string>& words, MasterClient& master);

}  // namespace iotcloud::master::cli
