#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/orders/orders.h>
#include <iotcloud/master/originals/site_client.h>

namespace iotcloud::master {

class Master;

/// What became of the sending of a plugin to one gateway.
struct UploadTarget {
  std::string gateway;
  std::string problem;  ///< why the gateway does not take it; empty: it does, or has it
  bool has = false;     ///< the plugin is there
};

/// The answer to a piece of an upload.
struct UploadResult {
  OrderResult refusal{};                ///< why nothing was passed on; Refusal::none: it was
  std::string upload{};                 ///< its id; empty: there is nothing (more) to be sent
  std::vector<UploadTarget> targets{};  ///< of all gateways that were named

  /// One line for people: "lab1 has it; lab2: it is lost".
  std::string summary() const;
};

/// Passes plugins that people send on to gateways' Thrift services, piece by piece and to all at the same time. Keeps
/// no piece: when this master ends, gateways clear away what they have got. Thread safe; each call blocks until all
/// gateways have answered or `answer_limit` has passed.
class PluginUploads {
 public:
  struct Options {
    int most = 8;                                    ///< uploads at once
    std::chrono::milliseconds idle_limit{60'000};    ///< an upload that nobody goes on with ends
    std::chrono::milliseconds answer_limit{10'000};  ///< of a gateway; one that has not answered gets no more
    const config::Clock* clock = nullptr;            ///< nullptr: the system's
    std::function<std::string()> new_upload_id;      ///< empty: ids that nobody guesses
  };
  /// \param master outlives this. \param access how it shows gateways who it is.
  PluginUploads(const Master& master, GatewayAccess access) : PluginUploads(master, std::move(access), Options()) {}
  PluginUploads(const Master& master, GatewayAccess access, const Options& options);
  ~PluginUploads();

  /// Asks gateways whether they want it. \param gateways empty: all that are registered.
  UploadResult offer(const PluginOffer& offer, const std::vector<std::string>& gateways);
  UploadResult send(const std::string& upload, std::int64_t offset, const std::string& bytes);
  UploadResult finish(const std::string& upload);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::master
