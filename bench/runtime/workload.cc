#include <random>

#include <iotcloud/bench/runtime/workload.h>

namespace iotcloud::bench {

Feed::Feed(const Options& options)
    : interval_ns_(options.rate > 0 ? 1e9 * static_cast<double>(results_of_item(options.dag)) / options.rate : 0) {}

void Feed::start() {
  start_ns_ = now_ns() + 50'000'000;  // the engine starts in this time
  if (!paced()) due_ = ~std::uint64_t{0};
}

bool Feed::look() {
  if (stopped()) return false;
  const auto elapsed = static_cast<double>(now_ns() - start_ns_);
  if (elapsed >= 0) due_ = static_cast<std::uint64_t>(elapsed / interval_ns_) + 1;
  return sent() < due_;
}

void Arrivals::record(const Feed& feed, std::uint64_t n) {
  if (n < first_recorded_.load(std::memory_order_relaxed)) return;
  const std::int64_t now = now_ns();
  latency.record_ns(now - feed.intended_ns(n));
  if (brought_ns != nullptr) service.record_ns(now - brought_ns->load(std::memory_order_relaxed));
}

Sentences::Sentences() {
  constexpr std::size_t vocabulary = 1000, sentences = 1024, words = 10;
  std::mt19937 random(20261121);
  std::vector<std::string> known;
  std::vector<double> frequency;
  std::uniform_int_distribution<int> letter('a', 'z');
  std::uniform_int_distribution<std::size_t> length(2, 10);
  for (std::size_t i = 0; i < vocabulary; ++i) {
    std::string word;
    for (std::size_t left = length(random); left > 0; --left) word += static_cast<char>(letter(random));
    known.push_back(std::move(word));
    frequency.push_back(1.0 / static_cast<double>(i + 1));
  }
  std::discrete_distribution<std::size_t> any(frequency.begin(), frequency.end());
  for (std::size_t i = 0; i < sentences; ++i) {
    std::string sentence = known[any(random)];
    for (std::size_t k = 1; k < words; ++k) sentence += ' ' + known[any(random)];
    all_.push_back(std::move(sentence));
  }
}

Payloads::Payloads() {
  for (int i = 0; i < 64; ++i) all_.push_back(brokers::Payload::take(std::vector<std::byte>(60'000, std::byte(i))));
}

}  // namespace iotcloud::bench
