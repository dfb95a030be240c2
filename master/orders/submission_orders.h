#pragma once

#include <chrono>
#include <string>
#include <vector>

#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// A topology to submit to the pools, or the next version of one that was submitted.
struct SubmitRequest {
  discovery::TopologyName topology;
  std::string yaml;
  std::vector<discovery::SentLibrary> libraries;
  int workers = 0;  ///< 0: one, or, of an update, as many as it has
  std::string manager;
  WaitLimit wait;  ///< of an update: for each worker, and as long again to go back
  /// Of an update: how long each worker must go on before the next one is updated.
  std::chrono::milliseconds settle{0};
  static constexpr const char* what = "a topology to submit";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(topology, required),
                                            IOTCLOUD_FIELD(yaml, required),
                                            IOTCLOUD_FIELD(libraries, usual),
                                            IOTCLOUD_FIELD(workers, usual),
                                            IOTCLOUD_FIELD(manager, rare),
                                            IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs),
                                            IOTCLOUD_FIELD_AS(settle, rare, "settle_ms", settleMs)};
};

/// A submitted topology that goes back to the version before.
struct RollbackRequest {
  discovery::TopologyName topology;
  WaitLimit wait;
  std::chrono::milliseconds settle{0};
  static constexpr const char* what = "a topology to roll back";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(topology, required), IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs),
                 IOTCLOUD_FIELD_AS(settle, rare, "settle_ms", settleMs)};
};

/// An order in words, for the audit log, without secrets.
std::string words(const SubmitRequest& request);
std::string words(const RollbackRequest& request);

/// SHA-256 over YAML and libraries, as TopologyVersion::digest.
std::string digest_of(const std::string& yaml, const std::vector<discovery::SentLibrary>& libraries);

}  // namespace iotcloud::master
