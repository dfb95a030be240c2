// A bolt that enters each message of the ledger driver in its instance's book, FOLDER/INSTANCE.came: a line
// "RUN NUMBER PROCESS MARKED TIME", where PROCESS is the worker's, and MARKED is 1 if the spout says that somebody may
// have had the message before, or 0. It emits the message as a command for that instance. Its configuration names the
// folder: `books`.
#include <filesystem>
#include <map>
#include <string>

#include "book.h"

#include <iotcloud/topology/plugin.h>

namespace {

using namespace iotcloud::topology;

class LedgerBolt final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void prepare(const Config& config, const TopologyContext&) override { folder_ = config.at("books"); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const Entry entry = Entry::parse(tuple.get<Payload>("data").text());
    auto book = books_.find(entry.instance);
    if (book == books_.end()) book = books_.emplace(entry.instance, Book(folder_ / (entry.instance + ".came"))).first;
    book->second.write(entry.run_and_number + ' ' + std::to_string(::getpid()) +
                       (tuple.get<bool>("redelivered") ? " 1" : " 0"));
    collector.emit(Values(tuple.get<Payload>("data"), tuple.at("driverID"), tuple.at("time")));
  }

 private:
  std::filesystem::path folder_;
  std::map<std::string, Book> books_;  ///< by instance
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<LedgerBolt>("chaos.Ledger");
}
