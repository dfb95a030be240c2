#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/kafka/reading/group.h"
#include "iotcloud/brokers/kafka/reading/reader.h"

namespace iotcloud::brokers::kafka {

/// All reading of one broker object: the reader's thread, which runs the handlers, and the thread that serves the
/// groups. Subscriptions of one group share one consumer. Thread safe.
class ConsumeLink {
 public:
  ConsumeLink(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log);
  /// Leaves all groups in order. Not from a handler.
  ~ConsumeLink();
  ConsumeLink(const ConsumeLink&) = delete;
  ConsumeLink& operator=(const ConsumeLink&) = delete;

  /// The first one starts the threads.
  std::shared_ptr<Inlet> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  void remove(const std::shared_ptr<Inlet>& inlet);
  Reader& reader() { return *reader_; }
  ConnectionState state() const;  ///< `connected` also when there is no subscription

 private:
  void run();

  const KafkaOptions options_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  client::WakeEvent wake_event_;
  const std::shared_ptr<Reader> reader_;

  mutable std::mutex mutex_;
  bool closing_ = false;                                  ///< guarded by mutex_
  std::map<std::string, std::shared_ptr<Group>> groups_;  ///< by name; guarded by mutex_, used by the thread
  std::vector<std::shared_ptr<Group>> leaving_;           ///< the thread's
  std::thread thread_;
};

}  // namespace iotcloud::brokers::kafka
