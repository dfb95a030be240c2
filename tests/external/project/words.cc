#include <cstdint>
#include <map>
#include <string>

#include <iotcloud/topology/plugin.h>

using namespace iotcloud::topology;

/// Emits the words of each line.
class Split : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"word"}); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto& line = tuple.get<std::string>("line");
    std::size_t begin = 0;
    for (auto end = line.find(' '); end != std::string::npos; end = line.find(' ', begin)) {
      collector.emit(Values(line.substr(begin, end - begin)));
      begin = end + 1;
    }
    collector.emit(Values(line.substr(begin)));
  }
};

/// Emits each word with how often it came.
class Count : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"word", "count"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto& word = tuple.get<std::string>("word");
    collector.emit(Values(word, ++words_[word]));
  }

 private:
  std::map<std::string, std::int64_t> words_;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Split>("words.Split");
  registry.add_bolt<Count>("words.Count");
}
