// A second reader beside the topology: one client, and no workers among which messages move. It enters each delivery in
// its instance's book, FOLDER/INSTANCE.read: a line "RUN NUMBER MARKED TIME", where MARKED is 1 if somebody may have
// had the message before, or 0. It makes FOLDER/reading once it reads all topics.
//
// usage: ledger_reader FOLDER URL HEARTBEAT_MS EXCHANGE TOPIC...
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "book.h"
#include <signal.h>
#include <sys/prctl.h>

#include <iotcloud/brokers/broker.h>

namespace {

using namespace iotcloud::brokers;

class Books {
 public:
  explicit Books(std::filesystem::path folder) : folder_(std::move(folder)) {}
  void enter(const Delivery& delivery) {
    const Entry entry = Entry::parse(delivery.message.payload.text());
    const std::lock_guard lock(mutex_);
    auto book = books_.find(entry.instance);
    if (book == books_.end()) book = books_.emplace(entry.instance, Book(folder_ / (entry.instance + ".read"))).first;
    book->second.write(entry.run_and_number + (delivery.redelivered ? " 1" : " 0"));
  }

 private:
  const std::filesystem::path folder_;
  std::mutex mutex_;
  std::map<std::string, Book> books_;  ///< by instance
};

}  // namespace

int main(int count, char** words) {
  if (count < 6) {
    std::cerr << "usage: ledger_reader FOLDER URL HEARTBEAT_MS EXCHANGE TOPIC...\n";
    return 2;
  }
  sigset_t ends;
  sigemptyset(&ends);
  sigaddset(&ends, SIGTERM);
  sigaddset(&ends, SIGINT);
  pthread_sigmask(SIG_BLOCK, &ends, nullptr);  // before the client starts its threads
  Books books(words[1]);
  BrokerOptions options;
  options.urls = {words[2]};
  options.heartbeat = std::chrono::milliseconds(std::atoi(words[3]));
  const auto broker = make_broker(options);
  SubscriptionOptions reading;
  reading.group = "chaos-reader";
  std::vector<std::unique_ptr<Subscription>> subscriptions;
  for (int i = 5; i < count; ++i) {
    const Topic topic{words[4], words[i], true};
    subscriptions.push_back(broker->subscribe(topic, reading, [&books](Delivery delivery) {
      books.enter(delivery);
      delivery.settle(Settlement::accept);
    }));
  }
  // What is published before the first reader's queue is there is not for it.
  constexpr timespec pause{0, 10'000'000};
  int signal = -1;
  const auto all_read = [&] {
    return std::all_of(subscriptions.begin(), subscriptions.end(), [](const auto& one) { return one->active(); });
  };
  while (signal < 0 && !all_read()) signal = sigtimedwait(&ends, nullptr, &pause);
  std::ofstream mark(std::string(words[1]) + "/reading");
  mark.close();
  if (signal < 0) sigwait(&ends, &signal);
  subscriptions.clear();
  return 0;
}
