// The DAGs on oneTBB's flow graph, as its documentation teaches: function nodes, serial where this project has one
// task, and a limiter that bounds its unbounded queues. It uses oneTBB's own number of workers; with one more, or with
// the thread that brings items working too, it is slower.
#include <array>
#include <tuple>

#include <oneapi/tbb/flow_graph.h>

#include <iotcloud/bench/runtime/measure.h>

namespace iotcloud::bench {

namespace {

namespace flow = oneapi::tbb::flow;

struct Item {
  std::uint64_t n = 0;
  std::string text;          ///< words
  brokers::Payload payload;  ///< payload
};
struct Small {
  std::uint64_t n = 0;
};

template <typename T>
T item_of(const Workload& work, std::uint64_t n) {
  if constexpr (std::is_same_v<T, Small>) {
    return {n};
  } else if (work.options.dag == Dag::words) {
    return {n, work.sentences[n], {}};
  } else {
    return {n, {}, work.payloads[n]};
  }
}

/// The source, the limiter, and the end of an item. Not paced: the graph asks its source. Paced: the thread that pumps
/// puts items in, and the graph takes them when the limiter allows it.
template <typename T>
class GraphEngine : public Engine {
 public:
  explicit GraphEngine(Workload& work)
      : work_(work),
        source_(graph_,
                [this](oneapi::tbb::flow_control& control) -> T {
                  if (work_.feed.due()) return item_of<T>(work_, work_.feed.take());
                  control.stop();
                  return {};
                }),
        waiting_(graph_),
        limiter_(graph_, max_pending),
        acks_(graph_, flow::serial, [this](const Small& small) {
          work_.arrivals[0].arrived(work_.feed, small.n, results_of_item(work_.options.dag));
          return flow::continue_msg{};
        }) {
    flow::make_edge(waiting_, limiter_);
    if (!work.feed.paced()) flow::make_edge(source_, limiter_);
    flow::make_edge(acks_, limiter_.decrementer());
  }
  void pump() override {
    if (!work_.feed.paced()) {
      source_.activate();
      return;
    }
    while (work_.feed.due()) waiting_.try_put(item_of<T>(work_, work_.feed.take()));
  }
  void stop() override { graph_.wait_for_all(); }

 protected:
  /// Item `n` is done: a separate node acks tracked items; other items only return their place to the limiter.
  void done(std::uint64_t n) {
    if (work_.options.tracked) {
      acks_.try_put({n});
    } else {
      limiter_.decrementer().try_put(flow::continue_msg{});
    }
  }
  Workload& work_;
  flow::graph graph_;
  flow::input_node<T> source_;
  flow::queue_node<T> waiting_;
  flow::limiter_node<T> limiter_;
  flow::function_node<Small, flow::continue_msg> acks_;
};

template <typename T>
class ChainEngine final : public GraphEngine<T> {
 public:
  ChainEngine(Workload& work, std::size_t width)
      : GraphEngine<T>(work),
        pass_(this->graph_, width, [](const T& item) { return item; }),
        sink_(this->graph_, flow::serial, [this](const T& item) {
          if constexpr (std::is_same_v<T, Item>) {
            if (!this->work_.payloads.is_same(item.n, item.payload)) ++this->work_.wrong;
          }
          if (!this->work_.options.tracked) this->work_.arrivals[0].arrived(this->work_.feed, item.n);
          this->done(item.n);
        }) {
    flow::make_edge(this->limiter_, pass_);
    flow::make_edge(pass_, sink_);
  }

 private:
  flow::function_node<T, T> pass_;
  flow::function_node<T> sink_;
};

class WordsEngine final : public GraphEngine<Item> {
 public:
  explicit WordsEngine(Workload& work)
      : GraphEngine<Item>(work),
        split_(graph_, 2,
               [this](const Item& sentence, Split::output_ports_type& ports) {
                 left_of(sentence.n) = results_of_item(Dag::words);
                 split(sentence.text, [&](std::string_view word) {
                   const bool second = std::hash<std::string_view>{}(word) % 2 == 1;
                   const Item item{sentence.n, std::string(word), {}};
                   second ? std::get<1>(ports).try_put(item) : std::get<0>(ports).try_put(item);
                 });
               }),
        count_{Count(graph_, flow::serial, [this](const Item& word) { count(0, word); }),
               Count(graph_, flow::serial, [this](const Item& word) { count(1, word); })} {
    flow::make_edge(limiter_, split_);
    flow::make_edge(flow::output_port<0>(split_), count_[0]);
    flow::make_edge(flow::output_port<1>(split_), count_[1]);
  }

 private:
  using Split = flow::multifunction_node<Item, std::tuple<Item, Item>>;
  using Count = flow::function_node<Item>;
  void count(std::size_t task, const Item& word) {
    ++counts_[task][word.text];
    if (!work_.options.tracked) work_.arrivals[task].arrived(work_.feed, word.n);
    if (--left_of(word.n) == 0) done(word.n);
  }
  /// Number of words of sentence `n` not yet counted; there are far more places than sentences under way.
  std::atomic<std::uint64_t>& left_of(std::uint64_t n) { return left_[n % left_.size()]; }
  std::vector<std::atomic<std::uint64_t>> left_ =
      std::vector<std::atomic<std::uint64_t>>(std::size_t{16} * max_pending);
  Split split_;
  std::array<WordCounts, 2> counts_;
  std::array<Count, 2> count_;
};

std::unique_ptr<Engine> make(Workload& work) {
  switch (work.options.dag) {
    case Dag::words:
      return std::make_unique<WordsEngine>(work);
    case Dag::fan:
      return std::make_unique<ChainEngine<Small>>(work, 4);
    case Dag::payload:
      return std::make_unique<ChainEngine<Item>>(work, flow::serial);
    default:
      return std::make_unique<ChainEngine<Small>>(work, flow::serial);
  }
}

}  // namespace

}  // namespace iotcloud::bench

int main(int argc, char** argv) {
  return iotcloud::bench::measure("onetbb", argc, argv, iotcloud::bench::make);
}
