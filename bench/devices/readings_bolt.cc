// The bolt at the end of the topology of `./dev bench devices`: it notes each reading on the board of its run. Its
// configuration names the folder of the boards: `boards`.
#include <filesystem>
#include <optional>
#include <stdexcept>

#include <iotcloud/bench/devices/board.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/plugin.h>

namespace {

using namespace iotcloud::topology;
using iotcloud::bench::Board;
using iotcloud::bench::Reading;

class Readings final : public BasicBolt {
 public:
  void prepare(const Config& config, const TopologyContext&) override { folder_ = config.at("boards"); }
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    Reading reading;
    if (!Reading::parse(tuple.get<Payload>("data").text(), reading))
      throw std::invalid_argument("this is no reading of bench_devices");
    if (!board_ || reading.run != run_) {
      board_.emplace(Board::file(folder_, reading.run));
      run_ = reading.run;
    }
    board_->take(reading);
  }

 private:
  std::filesystem::path folder_;
  std::optional<Board> board_;
  std::int64_t run_ = 0;
};

}  // namespace

IOTCLOUD_TOPOLOGY_LIBRARY(registry) {
  registry.add_bolt<Readings>("bench.Readings");
}
