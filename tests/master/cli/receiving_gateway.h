#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/discovery/records.h>
#include <iotcloud/rpc/thrift_server.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master::test {

/// The Thrift service of a gateway that accepts uploads. Thread safe.
class ReceivingSite final : public gateway::wire::TSensorSiteServiceNull {
 public:
  explicit ReceivingSite(std::string gateway) : gateway_(std::move(gateway)) {}

  void ping(gateway::wire::TPing& answer) override { answer.__set_gateway(gateway_); }
  void offerPlugin(std::string& upload, const gateway::wire::TPluginOffer& offer) override {
    const std::lock_guard lock(mutex_);
    offers_.push_back(offer);
    if (!refusal_.empty()) refuse();
    received_.clear();
    upload = finished_ == offer.sha256 ? "" : "u1";
  }
  void sendPlugin(const std::string& upload, std::int64_t offset, const std::string& bytes) override {
    const std::lock_guard lock(mutex_);
    if (upload != "u1" || offset != static_cast<std::int64_t>(received_.size())) {
      refusal_ = "out of order";
      refuse();
    }
    received_ += bytes;
    ++pieces_;
    if (!refusal_.empty()) refuse();
  }
  void finishPlugin(const std::string&) override {
    const std::lock_guard lock(mutex_);
    if (security::sha256_hex(received_) != offers_.back().sha256) {
      refusal_ = "other bytes";
      refuse();
    }
    finished_ = offers_.back().sha256;
  }

  void listPlugins(std::vector<discovery::wire::TKnownPlugin>& answer) override {
    const std::lock_guard lock(mutex_);
    answer = known_;
  }

  /// It has a plugin in its folder, which declares this.
  void have(const std::string& file, const std::string& declaration) {
    const std::lock_guard lock(mutex_);
    auto& plugin = known_.emplace_back();
    plugin.__set_file(file);
    plugin.__set_sha256(security::sha256_hex(declaration));
    plugin.__set_size(7);
    plugin.__set_signedBy("lab key");
    plugin.__set_signedVersion(3);
    plugin.__set_declaration(declaration);
  }
  /// It has no plugin any more.
  void forget() {
    const std::lock_guard lock(mutex_);
    finished_.clear();
  }
  void refuse_with(const std::string& reason) {
    const std::lock_guard lock(mutex_);
    refusal_ = reason;
  }
  std::string received() {
    const std::lock_guard lock(mutex_);
    return received_;
  }
  int pieces() {
    const std::lock_guard lock(mutex_);
    return pieces_;
  }
  gateway::wire::TPluginOffer offer() {
    const std::lock_guard lock(mutex_);
    return offers_.back();
  }
  std::size_t offers() {
    const std::lock_guard lock(mutex_);
    return offers_.size();
  }

 private:
  void refuse() const {
    gateway::wire::TSiteError error;
    error.__set_reason(refusal_);
    throw error;
  }
  const std::string gateway_;
  std::mutex mutex_;
  std::vector<gateway::wire::TPluginOffer> offers_;   ///< guarded by mutex_
  std::string received_, finished_, refusal_;         ///< guarded by mutex_
  int pieces_ = 0;                                    ///< guarded by mutex_
  std::vector<discovery::wire::TKnownPlugin> known_;  ///< guarded by mutex_
};

/// Sets the port of the service in the gateway's record.
inline void serve_at(const std::string& url, const std::string& id, int port) {
  const discovery::Paths paths;
  auto registry = open_registry(url);
  auto record = discovery::decode_gateway(registry->get(paths.gateway(discovery::GatewayId(id)))->data, id);
  record.port = port;
  discovery::put(*registry, paths.gateway(discovery::GatewayId(id)), encode(record));
}

/// A gateway that follows orders, and its Thrift service.
struct ServedGateway {
  ServedGateway(const std::string& url, const std::string& id)
      : gateway(url, id),
        site(std::make_shared<ReceivingSite>(id)),
        service({}, [processor = std::make_shared<iotcloud::gateway::wire::TSensorSiteServiceProcessor>(site)](
                        const auto&) { return processor; }) {
    serve_at(url, id, service.port());
  }
  FakeGateway gateway;
  const std::shared_ptr<ReceivingSite> site;
  rpc::ThriftServer service;
};

}  // namespace iotcloud::master::test
