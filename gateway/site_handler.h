#pragma once

#include <functional>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/gateway/site_plugins.h>
#include <iotcloud/gateway/site_service.h>

namespace iotcloud::gateway {

/// Implements the Thrift service's methods for one connection.
class SiteHandler final : public wire::TSensorSiteServiceIf {
 public:
  using Response = discovery::wire::TResponse;
  SiteHandler(const SiteService::Options& options, Gateway& gateway, discovery::Registry& registry,
              discovery::Paths paths, std::shared_ptr<rpc::CallerSession> session)
      : outcome_limit_(options.outcome_limit),
        answer_limit_(options.answer_limit),
        log_folder_(options.log_folder),
        gateway_(gateway),
        registry_(registry),
        paths_(std::move(paths)),
        session_(std::move(session)),
        plugins_(gateway.plugins()) {}

  void hearbeat(discovery::wire::THeartBeatResponse& answer,
                const discovery::wire::THeartBeatRequest& request) override;
  void deploySensor(Response& answer, const discovery::wire::TSensorDeployDescriptor& descriptor) override;
  void unDeploySensor(Response& answer, const std::string& id) override;
  void startSensor(Response& answer, const std::string& id) override {
    set_active(answer, discovery::InstanceId(id), true);
  }
  void stopSensor(Response& answer, const std::string& id) override {
    set_active(answer, discovery::InstanceId(id), false);
  }
  void authenticate(Response& answer, const std::string& token) override;
  void ping(wire::TPing& answer) override;
  void getChanges(std::vector<wire::TStateChange>& answer, const std::string& instance) override;
  void readLog(wire::TLogPart& answer, const std::string& instance, const std::string& position,
               std::int32_t most_bytes) override;
  void lookAtChannel(discovery::wire::TChannelLook& answer, const discovery::wire::TLookRequest& request) override;
  void handMessage(discovery::wire::TChannelLook& answer, const discovery::wire::THandedMessage& message) override;
  void getCarried(std::vector<wire::TCarried>& answer) override;
  void listPlugins(std::vector<discovery::wire::TKnownPlugin>& answer) override;
  void offerPlugin(std::string& upload, const wire::TPluginOffer& offer) override;
  void sendPlugin(const std::string& upload, std::int64_t offset, const std::string& bytes) override {
    plugins_.add(upload, offset, bytes);
  }
  void finishPlugin(const std::string& upload) override;

 private:
  /// \throws config::Error if this gateway follows signed orders only, because it cannot sign one itself, or has not
  /// registered yet, because the orders may be another gateway's.
  void check_may_order() const;
  void set_active(Response& answer, const discovery::InstanceId& id, bool active);
  void taking(const std::string& what);
  /// Waits for the outcome of an order. If it is not the wanted state, writes the failure into the answer.
  Gateway::AwaitedRecord await(Response& answer, const discovery::InstanceId& id, std::int64_t order_version,
                               discovery::DriverState wanted);
  /// Runs a method and turns an exception into a failure answer. \param what the subject of the call, for the audit log
  void answering(Response& answer, const std::string& what, const std::function<void()>& method);

  const std::chrono::milliseconds outcome_limit_, answer_limit_;
  const std::string log_folder_;
  Gateway& gateway_;
  discovery::Registry& registry_;
  const discovery::Paths paths_;
  const std::shared_ptr<rpc::CallerSession> session_;
  SitePlugins plugins_;
};

}  // namespace iotcloud::gateway
