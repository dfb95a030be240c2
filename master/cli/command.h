#pragma once

#include <chrono>
#include <cstdint>
#include <iosfwd>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/thrift/tls.h>

namespace iotcloud::master::cli {

enum class Verb {
  gateways,
  drivers,
  topologies,
  status,
  deploy,
  undeploy,
  start,
  stop,
  metadata,
  drain,
  undrain,
  diff,
  apply,
  update,
  keys_new,
  sign,
  describe,
  history,
  logs,
  topology_show,
  topology_activate,
  topology_deactivate,
  topology_rebalance,
  topology_kill,
  topology_metrics,
  topology_tap,
  topology_check,
  certs_init,
  certs_add,
  token_add,
  token_remove,
  token_list,
};
enum class Format { table, json, yaml };

/// One call of the CLI, parsed.
struct Command {
  Verb verb = Verb::status;
  std::vector<std::string> masters;
  config::TlsFiles tls;
  std::string token;
  Format format = Format::table;
  std::vector<std::string> gateways;   ///< drivers: only on these; orders: on these
  std::vector<std::string> instances;  ///< ids or their beginnings; orders: empty: what the next three leave
  std::string state;                   ///< only those in this state
  std::string where;                   ///< only those for which this expression holds; empty: all
  std::string driver;                  ///< only those of this driver; deploy: the driver's name
  std::string name;                    ///< only those of this deployment; deploy: the deployment's name
  std::string plugin;                  ///< with a slash: a file of this machine, which is sent
  int at_once = 0;                     ///< update: instances in one step; 0: all of one gateway
  std::int64_t settle_ms = 1'000;      ///< update, apply: how long those of a step must stay up
  std::string key;                     ///< sign: file with the private key
  bool progress = false;               ///< show on `err`, which is a terminal, how far a plugin is sent
  std::map<std::string, std::string> properties;
  std::map<std::string, std::string> metadata;  ///< deploy: what it is; metadata: what to change
  int count = 1;
  std::int64_t wait_ms = 0;  ///< 0: as long as the master thinks fit
  std::string topology;
  std::map<std::string, int> parallelism;  ///< rebalance: in each worker, by component
  std::int64_t drain_ms = 10'000;          ///< kill
  std::string component;                   ///< tap
  std::string stream;                      ///< tap: only this one; empty: all
  double rate = 10;                        ///< tap: samples a second of each task at most
  std::int64_t samples = 0;                ///< tap: ends after so many; 0: when interrupted
  double watch_s = 0;                      ///< metrics: again and again after so many seconds; 0: once
  std::string file;      ///< check, diff, apply, sign; token: the token file; keys new: how the files' names begin
  bool prune = true;     ///< diff, apply: what the manifest does not name any more goes
  bool adopt = false;    ///< diff, apply: what others deployed under its names becomes the manifest's
  bool dry_run = false;  ///< apply: as diff
  std::string folder;    ///< certs: where they are
  std::vector<std::string> hosts;    ///< certs: machines on which daemons run
  std::vector<std::string> callers;  ///< certs add: those who only call
  std::string token_name;            ///< token: whose
  std::string role;                  ///< token add
  bool follow = false;               ///< logs: go on until interrupted
  bool whole_host = false;           ///< logs: every line of its driver host, not only those that name it
  std::int32_t lines = 100;          ///< logs, history, describe: so many of the latest lines or changes
  /// How long an order is offered again while no master leads: longer than an election takes after a leader died.
  std::chrono::milliseconds election_patience{20'000};
};

/// What scripts may rely on.
enum ExitStatus {
  exit_ok = 0,
  exit_failed = 1,       ///< the order failed, for all or for some; or the master could not answer
  exit_usage = 2,        ///< the command line is wrong, or the beginning of an id fits several
  exit_unreachable = 3,  ///< no master answers
  exit_differs = 4,      ///< diff, apply --dry-run: the fleet is not as the manifest says
};

/// Ends what goes on until it is interrupted (metrics --watch, tap, logs --follow), in order. For a signal handler.
void interrupt();

/// Does what the command says. Results go to `out`, complaints to `err`. \return the exit status
int run(const Command& command, std::ostream& out, std::ostream& err);

}  // namespace iotcloud::master::cli
