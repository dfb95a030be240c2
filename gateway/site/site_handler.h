#pragma once

#include <functional>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/gateway/site/site_service.h>

namespace iotcloud::gateway {

/// What the service's methods do, for one connection.
class SiteHandler final : public wire::TSensorSiteServiceIf {
 public:
  using Response = discovery::wire::TResponse;
  SiteHandler(std::chrono::milliseconds outcome_limit, std::string log_folder, Gateway& gateway,
              discovery::Registry& registry, discovery::Paths paths, std::shared_ptr<config::Session> session)
      : outcome_limit_(outcome_limit),
        log_folder_(std::move(log_folder)),
        gateway_(gateway),
        registry_(registry),
        paths_(std::move(paths)),
        session_(std::move(session)) {}

  void hearbeat(discovery::wire::THeartBeatResponse& answer,
                const discovery::wire::THeartBeatRequest& request) override;
  void deploySensor(Response& answer, const discovery::wire::TSensorDeployDescriptor& descriptor) override;
  void unDeploySensor(Response& answer, const std::string& id) override;
  void startSensor(Response& answer, const std::string& id) override { set_active(answer, id, true); }
  void stopSensor(Response& answer, const std::string& id) override { set_active(answer, id, false); }
  void authenticate(Response& answer, const std::string& token) override;
  void ping(wire::TPing& answer) override;
  void getChanges(std::vector<wire::TStateChange>& answer, const std::string& instance) override;
  void readLog(wire::TLogPart& answer, const std::string& instance, const std::string& position,
               std::int32_t most_bytes) override;
  void offerPlugin(std::string& upload, const wire::TPluginOffer& offer) override;
  void sendPlugin(const std::string& upload, std::int64_t offset, const std::string& bytes) override;
  void finishPlugin(const std::string& upload) override;

 private:
  void set_active(Response& answer, const std::string& id, bool active);
  /// Waits for what came of an order, and puts it into the answer unless it is what was wanted.
  Gateway::Outcome await(Response& answer, const std::string& id, std::int64_t order_version,
                         discovery::DriverState wanted);
  /// Runs a method; what it throws becomes the answer. \param what it is about, for the log of orders
  void answering(Response& answer, const std::string& what, const std::function<void()>& method);

  const std::chrono::milliseconds outcome_limit_;
  const std::string log_folder_;
  Gateway& gateway_;
  discovery::Registry& registry_;
  const discovery::Paths paths_;
  const std::shared_ptr<config::Session> session_;
};

}  // namespace iotcloud::gateway
