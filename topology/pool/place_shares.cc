#include <algorithm>
#include <iterator>
#include <set>
#include <string>
#include <tuple>

#include <iotcloud/topology/pool/place_shares.h>

namespace iotcloud::topology {

using discovery::PlaceId;
using discovery::PoolId;
using discovery::Submission;

namespace {

/// A pool, and what it gets.
struct Share {
  const discovery::PoolRecord* pool = nullptr;
  std::set<std::string> files;
  std::set<PlaceId> places;

  std::size_t workers_of(const discovery::TopologyName& topology) const {
    return static_cast<std::size_t>(
        std::count_if(places.begin(), places.end(), [&](const PlaceId& place) { return place.topology == topology; }));
  }
  bool has_room() const {
    return pool->most_workers <= 0 || places.size() < static_cast<std::size_t>(pool->most_workers);
  }
  bool can_run(const Submission& submission, int place) const {
    const auto& libraries = submission.version_of(place).libraries;
    return std::all_of(libraries.begin(), libraries.end(),
                       [&](const auto& library) { return files.contains(library.sha256); });
  }
};

std::map<PoolId, Share> shares_of(const PoolView& view) {
  std::map<PoolId, Share> shares;
  for (const auto& pool : view.pools) shares[pool.id] = {&pool, {pool.files.begin(), pool.files.end()}, {}};
  return shares;
}

/// The pool with the fewest workers that can take the place; nullptr: none can.
Share* fewest(std::map<PoolId, Share>& shares, const Submission& submission, const PlaceId& place) {
  Share* best = nullptr;
  const auto load = [&](const Share& share) {
    return std::tuple(share.places.size(), share.workers_of(place.topology));
  };
  for (auto& [id, share] : shares) {
    if (!share.has_room() || !share.can_run(submission, place.number)) continue;
    if (best == nullptr || load(share) < load(*best)) best = &share;
  }
  return best;
}

/// Moves one place from a pool to one that has two workers less. \return whether there was one to move.
bool even_out(std::map<PoolId, Share>& shares, const PoolView& view) {
  std::vector<Share*> by_load;
  for (auto& [id, share] : shares) by_load.push_back(&share);
  std::stable_sort(by_load.begin(), by_load.end(),
                   [](const Share* a, const Share* b) { return a->places.size() < b->places.size(); });
  for (auto from = by_load.rbegin(); from != by_load.rend(); ++from) {
    for (Share* to : by_load) {
      if (to->places.size() + 2 > (*from)->places.size()) break;
      if (!to->has_room()) continue;
      for (auto place = (*from)->places.rbegin(); place != (*from)->places.rend(); ++place) {
        if (!to->can_run(view.submissions.at(place->topology), place->number)) continue;
        to->places.insert(*place);
        (*from)->places.erase(std::next(place).base());
        return true;
      }
    }
  }
  return false;
}

}  // namespace

std::map<PlaceId, PoolId> share_places(const PoolView& view) {
  auto shares = shares_of(view);
  std::vector<std::pair<PlaceId, const Submission*>> unheld;
  for (const auto& [topology, submission] : view.submissions) {
    if (submission.killed) continue;
    for (int number = 0; number < submission.workers; ++number) {
      const PlaceId place{topology, number};
      const auto holder = view.holders.find(place);
      const auto share = holder == view.holders.end() ? shares.end() : shares.find(holder->second.pool);
      if (share != shares.end() && share->second.has_room() && share->second.can_run(submission, number)) {
        share->second.places.insert(place);
      } else {
        unheld.emplace_back(place, &submission);
      }
    }
  }
  for (const auto& [place, submission] : unheld) {
    if (Share* share = fewest(shares, *submission, place)) share->places.insert(place);
  }
  while (even_out(shares, view)) {
  }
  std::map<PlaceId, PoolId> shared;
  for (const auto& [pool, share] : shares) {
    for (const auto& place : share.places) shared.emplace(place, pool);
  }
  return shared;
}

}  // namespace iotcloud::topology
