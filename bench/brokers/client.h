#pragma once

#include <functional>
#include <memory>

#include <iotcloud/bench/brokers/load.h>

namespace iotcloud::bench {

/// Both ends of the round trip in one process: the *device end* sends the load's messages and receives the echoes, the
/// *cloud end* sends back what it receives. Each has its own connections and threads, as two processes would have. With
/// `devices_only` there is no cloud end.
class Client {
 public:
  virtual ~Client() = default;
  /// Returns when messages can travel the whole way. \throws std::exception if that fails.
  virtual void connect() = 0;
  /// Begins to send on the load's schedule.
  virtual void begin() = 0;
  /// Closes everything; called when all messages have come back.
  virtual void stop() = 0;
};

using MakeClient = std::function<std::unique_ptr<Client>(const BrokerOptions&, Load&)>;

/// The main program of a client: runs the load, measures, checks that every message came back once and in order, and
/// prints one line of JSON. \return exit status.
int measure_client(const char* engine, int argc, char** argv, const MakeClient& make);

}  // namespace iotcloud::bench
