#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/master/orders/answers.h>
#include <iotcloud/rpc/http/http_site.h>

namespace iotcloud::master {

/// Tells the console's open pages what changes, by Server-Sent Events. It looks at the fleet once for all of them, and
/// not at all while nobody does; only the figures of the last hour are taken all the time, from the pages of
/// topologies' workers and from gateways. Thread safe.
///
/// Events: `state` (the master, gateways, topologies, counts of instances and what is wrong with them: when one of them
/// has changed), `rows` ({"reset", "set": [instance...], "gone": [{"gateway", "instance"}...], "more"}: what has
/// changed of the instances that the page has selected), `series` (points of the last hour, then each new one: [time in
/// ms, tuples a second of all spouts, 99 % of their trees are done within so many us]), `messages` (the same of
/// drivers: [time in ms, messages a second from them, to them, 99 % of the answers to theirs came within so many us];
/// null: not known, as while the registry is away), `beat` ({"ms"}: within so much time something comes again),
/// `topology` (the pages of its workers, every two seconds, and `former`: what its components had counted some time
/// ago), `over` (the session has ended). `losses` of `state`: the topologies' components that lost tuples of late
/// ({"topology", "component", "since_ms", "counts": {"late", "timed_out", "failed", "errors"}}).
class Live {
 public:
  /// What it looks at. Each call may block and throw config::Error. They outlive this.
  struct Source {
    std::function<MasterStatus()> status;
    std::function<std::vector<discovery::DriverRecord>()> drivers;
    std::function<std::vector<discovery::GatewayStatus>()> gateways;
    std::function<std::vector<discovery::TopologyStatus>()> topologies;
    /// What each driver host has carried since it began; hosts whose gateway does not answer are left out.
    std::function<std::vector<CarriedByGateway>()> carried;
    /// The page /topology of a worker.
    std::function<std::string(const discovery::TopologyName&, const std::string& worker)> worker_page;
  };
  struct Options {
    std::chrono::milliseconds look{1'000};     ///< between two looks at the fleet, or twenty times what one took
    std::chrono::milliseconds pages{2'000};    ///< between two readings of the pages of a topology that somebody sees
    std::chrono::milliseconds sample{10'000};  ///< between two points of the last hour
    std::chrono::milliseconds beat{10'000};    ///< between two signs of life on a stream where nothing changes
    std::size_t points = 360;
    /// Between two countings of a topology's components that are remembered; their counts are told since one, 18 and
    /// 144 of these (ten minutes, three hours, a day).
    std::chrono::milliseconds remember{600'000};
    /// A component that has lost tuples is told of until so long after the last one.
    std::chrono::milliseconds remind{60'000};
  };
  explicit Live(Source source) : Live(std::move(source), Options()) {}
  /// \param clock outlives this
  Live(Source source, Options options, const config::Clock& clock = config::system_clock());
  ~Live();
  Live(const Live&) = delete;
  Live& operator=(const Live&) = delete;

  /// What a page shows.
  struct Wanted {
    bool rows = false;
    discovery::Selection where;
    discovery::TopologyName topology;  ///< empty: none
  };
  /// Tells a page until its reader has gone. \param may whether it may still see this; asked now and then, on a thread
  /// of this object
  void follow(std::shared_ptr<rpc::HttpStream> stream, Wanted wanted, std::function<bool()> may)
      IOTCLOUD_EXCLUDES(mutex_);
  /// The record of one instance, as the last look found it, or a new look if there was none.
  std::optional<discovery::DriverRecord> find(const discovery::GatewayId& gateway,
                                              const discovery::InstanceId& instance) IOTCLOUD_EXCLUDES(mutex_);
  std::size_t followers() const IOTCLOUD_EXCLUDES(mutex_);

 private:
  using Text = std::shared_ptr<const std::string>;
  using Key = std::pair<std::string, std::string>;  ///< gateway, instance
  struct Row {
    discovery::DriverRecord record;
    std::string json;
  };
  struct Follower {
    std::shared_ptr<rpc::HttpStream> stream;
    Wanted wanted;
    std::function<bool()> may;
    bool fresh = true;             ///< it has been told nothing yet
    config::Clock::Instant told;   ///< when something was sent last
    config::Clock::Instant asked;  ///< when `may` was asked last
  };
  /// Points of the last hour.
  struct Series {
    const char* event;
    std::deque<std::string> points{};  ///< JSON, the oldest first
  };
  /// Names and numbers of what a component's tasks count.
  using Counts = std::map<std::string, std::uint64_t>;
  using Components = std::map<std::string, Counts>;
  struct Remembered {
    config::Clock::Instant at;
    Components components;
  };
  /// What a topology's workers have counted so far.
  struct Counted {
    std::uint64_t emitted = 0;
    std::map<double, std::uint64_t> complete;  ///< by the buckets' upper ends, in microseconds
    Components components;
  };
  /// What a driver host had carried at some time.
  struct CarriedThen {
    discovery::CarriedMessages messages;
    config::Clock::Instant at;
  };
  using Carried = std::map<Key, CarriedThen>;  ///< by gateway and host
  /// What a component lost since `since_ms`.
  struct Loss {
    Counts counts;
    std::int64_t since_ms = 0;
    config::Clock::Instant last;
    bool told = false;  ///< to whoever looks: a look can come later than what it reminds of is over
  };
  using Losses = std::map<Key, Loss>;  ///< by topology and component
  using Followers = std::list<Follower>;

  void look_on(const std::stop_token& stop);
  void read_pages_on(const std::stop_token& stop);
  void look() IOTCLOUD_EXCLUDES(mutex_);
  std::string state_of(const std::string& problem);
  Text beat() const;
  void send(Follower& follower, Text text) IOTCLOUD_REQUIRES(mutex_);
  void send_rows(Follower& follower, const std::vector<Key>& changed) IOTCLOUD_REQUIRES(mutex_);
  void tell_all(const std::vector<Key>& changed) IOTCLOUD_EXCLUDES(mutex_);
  void read_pages(bool sample) IOTCLOUD_EXCLUDES(mutex_);
  static void add(const Counted& of_worker, Counted& all);
  Counted show(const discovery::TopologyStatus& topology, bool wanted) IOTCLOUD_EXCLUDES(mutex_);
  void remember(const std::map<std::string, Counted>& now);
  nlohmann::ordered_json former(const discovery::TopologyName& topology) const;
  void count_tuples(const std::map<std::string, Counted>& now) IOTCLOUD_EXCLUDES(mutex_);
  void count_messages_on(const std::stop_token& stop);
  std::optional<Carried> carried_now() const;
  void count_messages(const Carried& before, const Carried& now) IOTCLOUD_EXCLUDES(mutex_);
  void add_point(Series& series, const nlohmann::ordered_json& point) IOTCLOUD_REQUIRES(mutex_);
  void send_points(Follower& follower, const Series& series) IOTCLOUD_REQUIRES(mutex_);
  void note_losses(const std::map<std::string, Counted>& now) IOTCLOUD_EXCLUDES(mutex_);
  nlohmann::ordered_json tell_losses() IOTCLOUD_REQUIRES(mutex_);

  const Source source_;
  const Options options_;
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  Followers followers_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<Key, Row> rows_ IOTCLOUD_GUARDED_BY(mutex_);
  Text state_ IOTCLOUD_GUARDED_BY(mutex_);  ///< the event that was sent last
  bool looked_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  Series tuples_ IOTCLOUD_GUARDED_BY(mutex_){"series"};
  Series messages_ IOTCLOUD_GUARDED_BY(mutex_){"messages"};
  Losses losses_ IOTCLOUD_GUARDED_BY(mutex_);
  // Used by the thread that reads pages.
  std::map<std::string, Counted> counted_;
  std::map<Key, Counted> of_workers_;  ///< by topology and worker: what its page said last
  config::Clock::Instant counted_at_{};
  std::map<std::string, std::deque<Remembered>> remembered_;  ///< by topology, the oldest first
  // Used by the thread that looks.
  std::vector<discovery::GatewayStatus> gateways_;
  std::vector<discovery::TopologyStatus> topologies_;
  MasterStatus master_;
  std::jthread looks_, pages_, messages_counter_;
};

}  // namespace iotcloud::master
