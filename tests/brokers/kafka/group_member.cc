// A member of a consumer group in a process of its own, which a test can freeze: enters "DRIVER BODY" of each message
// in a file, one line each.
//
// usage: group_member FILE URL GROUP TOPIC
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <string>

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <iotcloud/brokers/broker.h>

int main(int count, char** words) {
  using namespace iotcloud::brokers;
  if (count != 5) {
    std::cerr << "usage: group_member FILE URL GROUP TOPIC\n";
    return 2;
  }
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);  // with the test
  const int file = ::open(words[1], O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  BrokerOptions options;
  options.urls = {words[2]};
  options.heartbeat = std::chrono::seconds(1);
  options.rpc_timeout = std::chrono::seconds(1);
  options.properties["partitions"] = "4";
  const auto broker = make_broker(options);
  SubscriptionOptions reading;
  reading.group = words[3];
  const auto subscription = broker->subscribe({"", words[4], false}, reading, [&](Delivery delivery) {
    const std::string line = delivery.message.driver_id + ' ' + std::string(delivery.message.payload.text()) + '\n';
    if (::write(file, line.data(), line.size()) != static_cast<ssize_t>(line.size())) std::abort();
    delivery.settle(Settlement::accept);
  });
  while (true) ::pause();
}
