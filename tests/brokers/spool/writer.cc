// A process that publishes through a spool until it is killed: writer URL TOPIC FOLDER ROUND
// It sends "ROUND.1", "ROUND.2", ... and writes one line with the number for each that was accepted. With ROUND 0 it
// publishes nothing, and ends when all that is in the spool was sent.
#include <chrono>
#include <cstdint>
#include <exception>
#include <iostream>
#include <semaphore>
#include <string>

#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <iotcloud/brokers/spool/spooled_publisher.h>

using namespace iotcloud;

namespace {

int run(const std::string& url, const brokers::Topic& topic, const std::string& folder, int round) {
  brokers::BrokerOptions broker_options;
  broker_options.urls = {url};
  const auto broker = brokers::make_broker(broker_options);
  std::counting_semaphore<> writable(0);
  brokers::PublisherOptions options;
  options.capacity = 64;
  options.on_writable = [&] { writable.release(); };
  brokers::SpoolOptions spool;
  spool.folder = folder;
  spool.max_bytes = std::uint64_t{1} << 30;
  spool.sync = brokers::SpoolSync::never;
  const auto publisher = brokers::make_spooled_publisher(*broker, topic, options, spool);
  if (round == 0) return publisher->drain(std::chrono::seconds(120)) ? 0 : 1;
  for (int i = 1;; ++i) {
    brokers::Message message;
    message.payload =
        brokers::Payload::copy(std::to_string(round) + "." + std::to_string(i) + std::string(i % 700, ' '));
    message.driver_id = "writer";
    while (publisher->publish(message) != brokers::PublishStatus::accepted) writable.acquire();
    const std::string line = std::to_string(i) + "\n";
    if (::write(STDOUT_FILENO, line.data(), line.size()) < 0) return 1;
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);  // so that no writer survives a killed test
  try {
    return run(argv[1], {"spool.kill", argv[2], true}, argv[3], std::stoi(argv[4]));
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
}
