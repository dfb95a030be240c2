#include <chrono>
#include <deque>
#include <fstream>
#include <map>
#include <stdexcept>
#include <string>
#include <utility>

#include <iotcloud/topology/plugin.h>

using namespace iotcloud::topology;

/// Emits each line of the file `path`, also those that are added later, and a line again when its tuple failed.
class Lines : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"line"}); }
  void open(const Config& config, const TopologyContext&, SpoutOutputCollector& collector) override {
    collector_ = &collector;
    file_.open(config.at("path"));
    if (!file_) throw std::runtime_error("cannot read " + config.at("path"));
  }
  bool next_tuple() override {
    if (!failed_.empty()) {
      const MessageId id = failed_.front();
      failed_.pop_front();
      collector_->emit(Values(under_way_.at(id)), id);  // the same id: the same message, tried again
      return true;
    }
    std::string line;
    if (!std::getline(file_, line)) {
      file_.clear();  // at its end; look again after poll_period()
      return false;
    }
    const MessageId id = ++last_;
    under_way_[id] = line;
    collector_->emit(Values(std::move(line)), id);
    return true;
  }
  void ack(MessageId id) override { under_way_.erase(id); }
  void fail(MessageId id) override { failed_.push_back(id); }
  std::chrono::microseconds poll_period() const override { return std::chrono::milliseconds(100); }

 private:
  SpoutOutputCollector* collector_ = nullptr;
  std::ifstream file_;
  MessageId last_ = 0;
  std::map<MessageId, std::string> under_way_;
  std::deque<MessageId> failed_;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_spout<Lines>("lines.Lines");
}
