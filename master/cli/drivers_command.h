#pragma once

#include <iosfwd>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/master/cli/command.h>
#include <iotcloud/master/cli/master_client.h>

namespace iotcloud::master::cli {

/// The command line asks for something that is not clear.
class Ambiguous : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// What `--where` says. \throws std::invalid_argument with the place where it is wrong.
discovery::Selection where_of(const Command& command);

/// `iotcloud drivers`. \throws Unreachable, Failed
int show_drivers(const Command& command, const discovery::Selection& where, MasterClient& master, std::ostream& out);

/// One driver's record as JSON, and as it stands in tables.
nlohmann::ordered_json to_json(const discovery::wire::TSensor& driver);
std::string metadata_words(const discovery::wire::TSensor& driver);
/// Its name and number: "camera/2"; "-" when it was deployed without one.
std::string full_name(const discovery::wire::TSensor& driver);
/// Which plugin it runs, and whether somebody who is trusted signed it.
std::string plugin_words(const discovery::wire::TSensor& driver);

/// Ids of the instances that the options of `iotcloud drivers` leave. \throws Unreachable; Failed, also when there is
/// none.
std::vector<std::string> fitting_ids(const Command& command, const discovery::Selection& where, MasterClient& master);

/// Ids in full from their beginnings. One that no record has is passed on: its order may not have been taken up yet.
/// \throws Ambiguous, Unreachable, Failed
std::vector<std::string> full_ids(const std::vector<std::string>& beginnings, MasterClient& master);

}  // namespace iotcloud::master::cli
