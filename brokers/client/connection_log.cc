#include "iotcloud/brokers/client/connection_log.h"

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::client {
namespace {

const config::Logger logger{"brokers"};

}  // namespace

void ConnectionLog::failed(const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (said_away_) return;
  said_away_ = true;
  said_connected_ = false;
  logger.warn("cannot connect to {}: {}; trying again", url_, reason);
}

void ConnectionLog::lost(const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (said_away_) return;
  said_away_ = true;
  said_connected_ = false;
  logger.warn("lost the connection to {}: {}; connecting again", url_, reason);
}

void ConnectionLog::connected() {
  const std::lock_guard lock(mutex_);
  if (said_connected_) return;
  said_connected_ = true;
  said_away_ = false;
  logger.info("connected to {}", url_);
}

}  // namespace iotcloud::brokers::client
