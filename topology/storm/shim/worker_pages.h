#pragma once

#include <optional>

#include <iotcloud/rpc/http/http_server.h>

namespace iotcloud::topology::storm {

/// The page /metrics of one of Storm's workers (`metrics` in the topology's file). All workers of a machine have the
/// same settings, so each takes the first free one of `ports_of_a_machine` ports, from that of the address on, and logs
/// it.
class WorkerPages {
 public:
  static constexpr int ports_of_a_machine = 32;

  /// \param settings without an address there is no page. \throws config::Error when none of the ports can be used.
  explicit WorkerPages(const rpc::PageSettings& settings);

  std::string address() const { return server_ ? server_->address() : ""; }  ///< host:port; empty: there is no page

 private:
  std::optional<rpc::HttpServer> server_;
};

}  // namespace iotcloud::topology::storm
