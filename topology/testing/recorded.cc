#include <map>
#include <memory>

#include <iotcloud/recording/recording.h>
#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/endpoints/message_fields.h>
#include <iotcloud/topology/testing/recorded.h>
#include <iotcloud/topology/worker/check.h>

namespace iotcloud::topology::testing {

namespace {

/// Stands for a spout that reads a broker; complete_topology() says what it emits.
class RecordedSpout final : public Spout {
 public:
  explicit RecordedSpout(Fields fields) : fields_(std::move(fields)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(fields_); }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector&) override {}
  bool next_tuple() override { return false; }

 private:
  const Fields fields_;
};

/// Stands for a bolt that sends to a broker.
class SentMessages final : public Bolt {
 public:
  explicit SentMessages(EndpointDefinition endpoint)
      : endpoint_(with_own_builder(std::move(endpoint))), built_(payload_fields(endpoint_)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"driverID", "payload", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override {
    collector_ = &collector;
    if (endpoint_.make_builder) builder_ = endpoint_.make_builder();
  }
  void execute(const Tuple& tuple) override {
    if (tuple.is_tick()) return;
    const SimulatedClock start;  // a message without a time gets that of the simulation's start
    const auto message = message_of(tuple, endpoint_, built_, builder_.get(), start);
    collector_->emit(tuple, Values(message.driver_id, message.payload, message.time_ms));
    collector_->ack(tuple);
  }

 private:
  const EndpointDefinition endpoint_;
  const Fields built_;
  std::unique_ptr<MessageBuilder> builder_;
  OutputCollector* collector_ = nullptr;
};

/// What a `where` sees of a recorded instance.
discovery::DriverRecord record_of(const recording::RecordedChannel& channel) {
  discovery::DriverRecord record;
  record.name = discovery::DriverName(channel.driver);
  record.instance = discovery::InstanceId(channel.instance);
  record.gateway = discovery::GatewayId(channel.gateway);
  record.state = discovery::DriverState::active;
  record.metadata = channel.metadata;
  return record;
}

/// A spout of the file, and which channels of the recording it reads.
struct RecordedInput {
  RecordedInput(const ComponentDefinition& spout, const recording::RecordingReader& recording)
      : id(spout.id), endpoint(with_own_builder(*spout.endpoint)), built(payload_fields(endpoint)) {
    if (endpoint.stream != default_stream)
      throw spout.section.error("stream", "on a recording a spout emits to the default stream only");
    if (endpoint.make_builder) builder = endpoint.make_builder();
    for (const auto& channel : recording.channels()) {
      reads.push_back(channel.out && channel.driver == endpoint.driver.str() && channel.name == endpoint.channel &&
                      endpoint.where.matches(record_of(channel)));
    }
  }
  std::string id;
  EndpointDefinition endpoint;
  Fields built;
  std::unique_ptr<MessageBuilder> builder;
  std::vector<bool> reads;
};

}  // namespace

CompletedTopology run_on_recording(const std::string& yaml_file, const std::string& file, RecordedRun options) {
  const auto definition = TopologyDefinition::load(yaml_file);
  load_libraries(definition, options.library_folders, options.components);
  EndpointFactories factories;
  std::vector<ComponentDefinition> spouts;
  factories.spout = [&](const ComponentDefinition& spout) -> SpoutFactory {
    spouts.push_back(spout);  // with the builder that assemble() found
    return [fields = spout.endpoint->fields] { return std::make_unique<RecordedSpout>(fields); };
  };
  factories.bolt = [](const ComponentDefinition& bolt) -> BoltFactory {
    return [endpoint = *bolt.endpoint] { return std::make_unique<SentMessages>(endpoint); };
  };
  const Topology topology = assemble(definition, options.components, factories);

  recording::RecordingReader recording(file);
  std::vector<RecordedInput> inputs;
  for (const auto& spout : spouts) inputs.emplace_back(spout, recording);
  CompleteOptions complete;
  complete.run_for = options.run_for;
  complete.step = options.step;
  for (const auto& input : inputs) complete.timed_inputs[input.id];
  while (const auto recorded = recording.next()) {
    for (const auto& input : inputs) {
      if (!input.reads[recorded->channel]) continue;
      complete.timed_inputs[input.id].push_back(
          {recorded->at - recording.start(),
           values_of(recorded->message, input.endpoint, input.built, input.builder.get(), false)});
    }
  }
  return complete_topology(topology, complete);
}

}  // namespace iotcloud::topology::testing
