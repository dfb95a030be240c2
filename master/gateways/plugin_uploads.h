#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/master/gateways/gateway_access.h>
#include <iotcloud/master/gateways/pool_client.h>
#include <iotcloud/master/gateways/site_client.h>

namespace iotcloud::master {

class Master;

/// Passes plugins that people send on to gateways' Thrift services, and component libraries to those of pools, piece by
/// piece and to all at the same time. The
/// master keeps no piece; when it ends, gateways remove the pieces that they have got. Thread safe; each call blocks
/// until all gateways have answered or `answer_limit` has passed.
class PluginUploads {
 public:
  struct Options {
    int most = 8;                                  ///< the most uploads at once
    std::chrono::milliseconds idle_limit{60'000};  ///< an upload that gets no piece for so long ends
    std::chrono::milliseconds answer_limit{
        10'000};                           ///< of a gateway; one that has not answered in time gets no more pieces
    const config::Clock* clock = nullptr;  ///< nullptr: the system's
    std::function<std::string()> new_upload_id;  ///< empty: random ids, which nobody can guess
  };
  /// \param master outlives this. \param access the credentials for gateways. \param pools those for pools
  PluginUploads(const Master& master, GatewayAccess access, PoolAccess pools = {})
      : PluginUploads(master, std::move(access), std::move(pools), Options()) {}
  PluginUploads(const Master& master, GatewayAccess access, PoolAccess pools, const Options& options);
  ~PluginUploads();

  /// Offers a plugin to gateways, which say whether they need it. \param gateways empty: all that are registered.
  UploadResult offer(const PluginOffer& offer, const std::vector<discovery::GatewayId>& gateways);
  /// The same for a component library, to all pools that live. An answer's `gateway` is a pool.
  UploadResult offer_library(const PluginOffer& offer);
  UploadResult send(const std::string& upload, std::int64_t offset, const std::string& bytes);
  UploadResult finish(const std::string& upload);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
