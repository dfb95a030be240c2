#pragma once

#include <cstddef>
#include <iosfwd>
#include <string>
#include <vector>

#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/orders/submission_orders.h>

namespace iotcloud::master::cli {

/// A topology's file as `iotcloud-topology` has checked it.
struct CheckedTopology {
  /// A component library that the file names.
  struct Library {
    std::string name;  ///< as the file has it
    std::string path;  ///< where it is
  };
  discovery::TopologyName name;
  std::string yaml;
  std::vector<Library> libraries;
  std::string crossings;  ///< why several workers may not run it; empty: they may
};

/// The engine that is to run a topology: "pool" or "storm", as the command line says, else as its file does
/// (`engine.storm`). \param given empty: the command line names none. \throws config::ConfigError when the two differ
std::string engine_for(const std::string& file, const std::string& given);

/// Checks a topology's file, its libraries and their classes, by the program iotcloud-topology beside this one; asks no
/// master. \throws config::Error with what is wrong; config::ConfigError for a file that names another engine than
/// pools
CheckedTopology check_file(const std::string& file);

/// Refuses several workers for a topology that regroups tuples over drivers. \throws config::Error that names the
/// inputs
void check_workers(const CheckedTopology& topology, int workers);

/// Checks the file, sends its libraries to the pools, and fills in name, YAML and libraries of the request.
/// \param failures one for each library and pool that did not take it
/// \throws config::Error; Unreachable, RequestFailed
void prepare(SubmitRequest& request, const std::string& file, MasterClient& master, std::ostream* terminal,
             std::vector<InstanceOutcome>& failures);

/// Orders what was prepared. \param update of a topology that is submitted; else it must not be
OrderResult give(const SubmitRequest& request, bool update, MasterClient& master);

/// How many steps an update of the topology takes: one for each worker that it has or gets, and the way back.
std::size_t steps_of(const discovery::TopologyName& topology, MasterClient& master, int workers = 0);

}  // namespace iotcloud::master::cli
