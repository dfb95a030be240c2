#include <algorithm>
#include <cstdint>
#include <numeric>
#include <string_view>
#include <utility>

#include <iotcloud/topology/endpoints/placement/fair_shares.h>

namespace iotcloud::topology {

namespace {

/// The finalizer of MurmurHash3.
std::uint64_t mix(std::uint64_t h) {
  h = (h ^ (h >> 33)) * 0xff51afd7ed558ccdULL;
  h = (h ^ (h >> 33)) * 0xc4ceb9fe1a85ec53ULL;
  return h ^ (h >> 33);
}

/// FNV-1a and mix(): every process and version must compute the same value.
std::uint64_t hash(std::string_view text) {
  std::uint64_t h = 0xcbf29ce484222325ULL;
  for (const char c : text) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001b3ULL;
  return mix(h);
}

/// A worker's slots. Their number is that of its tasks, divided by the greatest common divisor of all workers' numbers
/// of tasks, so a slot stands for several tasks. Of each kind every slot takes either the least number of units or one
/// more; a slot with one more is raised.
struct Bidder {
  std::vector<std::uint64_t> seeds;  ///< for the hash, one for each slot
  std::size_t raised = 0;            ///< number of slots that have one unit more than others, over the kinds so far
  std::size_t load = 0;              ///< units of the present kind
  std::size_t first = 0;             ///< slots that the present kind raised and that were not raised before
  std::size_t second = 0;            ///< slots that the present kind raised again; only when all slots are raised once

  std::uint64_t score(std::uint64_t unit) const {
    std::uint64_t best = 0;
    for (const std::uint64_t seed : seeds) best = std::max(best, mix(unit ^ seed));
    return best;
  }
};

std::vector<Bidder> bidders_of(const std::vector<Sharer>& sharers) {
  int common = 0;
  for (const auto& sharer : sharers) common = std::gcd(common, sharer.tasks);
  std::vector<Bidder> bidders(sharers.size());
  for (std::size_t i = 0; i < sharers.size(); ++i) {
    const std::uint64_t name = hash(sharers[i].worker);
    for (int slot = 0; slot < sharers[i].tasks / common; ++slot) {
      bidders[i].seeds.push_back(mix(name + static_cast<std::uint64_t>(slot)));
    }
  }
  return bidders;
}

/// Shares out the units of one kind. A raised slot is raised again only when all slots are raised.
std::vector<std::size_t> share(const std::vector<std::string>& units, std::vector<Bidder>& bidders) {
  std::size_t slots = 0, raised = 0;
  for (auto& bidder : bidders) {
    slots += bidder.seeds.size();
    raised += bidder.raised;
    bidder.load = bidder.first = bidder.second = 0;
  }
  const std::size_t least = units.size() / slots;
  std::size_t first = std::min(units.size() % slots, slots - raised);
  std::size_t second = units.size() % slots - first;
  // all slots are raised once after this kind, which is where counting begins again
  const bool level = raised + first == slots;

  std::vector<std::pair<std::uint64_t, std::size_t>> order;
  for (std::size_t i = 0; i < units.size(); ++i) order.emplace_back(hash(units[i]), i);
  std::sort(order.begin(), order.end(), [&](const auto& a, const auto& b) {
    return a.first != b.first ? a.first < b.first : units[a.second] < units[b.second];
  });

  std::vector<std::size_t> shares(units.size());
  for (const auto& [unit, place] : order) {
    std::size_t best = bidders.size();
    std::uint64_t best_score = 0;
    for (std::size_t i = 0; i < bidders.size(); ++i) {
      const Bidder& bidder = bidders[i];
      const bool room = bidder.load < least * bidder.seeds.size() ||
                        (first > 0 && bidder.first + bidder.raised < bidder.seeds.size()) ||
                        (second > 0 && bidder.second < bidder.raised);
      if (!room) continue;
      const std::uint64_t score = bidder.score(unit);
      if (best < bidders.size() && score <= best_score) continue;
      best = i;
      best_score = score;
    }
    Bidder& taker = bidders[best];
    if (taker.load++ >= least * taker.seeds.size()) {
      if (first > 0 && taker.first + taker.raised < taker.seeds.size()) {
        ++taker.first;
        --first;
      } else {
        ++taker.second;
        --second;
      }
    }
    shares[place] = best;
  }
  for (auto& bidder : bidders) bidder.raised = level ? bidder.second : bidder.raised + bidder.first;
  return shares;
}

}  // namespace

std::vector<std::vector<std::size_t>> fair_shares(const std::vector<std::vector<std::string>>& kinds,
                                                  const std::vector<Sharer>& sharers) {
  auto bidders = bidders_of(sharers);
  std::vector<std::vector<std::size_t>> shares;
  for (const auto& units : kinds) shares.push_back(share(units, bidders));
  return shares;
}

}  // namespace iotcloud::topology
