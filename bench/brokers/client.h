#pragma once

#include <functional>
#include <memory>

#include <iotcloud/bench/brokers/load.h>

namespace iotcloud::bench {

/// Both ends of the round trip in one process: the *device end* sends the load's messages and takes what comes back,
/// the *cloud end* sends back what it receives, each with its own connections and threads, as two processes would have
/// them. With `devices_only` there is no cloud end.
class Client {
 public:
  virtual ~Client() = default;
  /// Returns when messages can travel the whole way. \throws std::exception when that fails.
  virtual void connect() = 0;
  /// Sending begins, as the load's schedule says.
  virtual void begin() = 0;
  /// All that was sent has come back: closes.
  virtual void stop() = 0;
};

using MakeClient = std::function<std::unique_ptr<Client>(const BrokerOptions&, Load&)>;

/// The main program of a client: runs the load, measures, checks that everything came back once and in order, and
/// prints one line of JSON. \return exit status.
int measure_client(const char* engine, int argc, char** argv, const MakeClient& make);

}  // namespace iotcloud::bench
