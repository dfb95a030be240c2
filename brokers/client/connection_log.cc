#include "iotcloud/brokers/client/connection_log.h"

#include <iotcloud/brokers/logger.h>

namespace iotcloud::brokers::client {
namespace {

// Logs at most this many reasons in a row.
constexpr std::size_t most_reasons = 8;

}  // namespace

bool ConnectionLog::first(std::set<std::string>& said, const std::string& text) {
  return said.size() < most_reasons && said.insert(text).second;
}

void ConnectionLog::failed(const std::string& server, const std::string& reason) {
  const config::MutexLock lock(mutex_);
  problem_ = reason;
  if (!first(said_failures_, server + reason)) return;
  said_connected_.clear();
  logger.warn("cannot connect to {}: {}; trying again", server, reason);
}

void ConnectionLog::lost(const std::string& server, const std::string& reason) {
  const config::MutexLock lock(mutex_);
  problem_ = reason;
  if (said_lost_) return;
  said_lost_ = true;
  said_connected_.clear();
  said_failures_.clear();
  logger.warn("lost the connection to {}: {}; connecting again", server, reason);
}

void ConnectionLog::connected(const std::string& server) {
  const config::MutexLock lock(mutex_);
  problem_.clear();
  if (!first(said_connected_, server)) return;
  said_lost_ = false;
  said_failures_.clear();
  logger.info("connected to {}", server);
}

std::string ConnectionLog::problem() const {
  const config::MutexLock lock(mutex_);
  return problem_;
}

}  // namespace iotcloud::brokers::client
