#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/broker_states.h>
#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/gateway/host/found_things.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/host/losing_channel.h>
#include <iotcloud/gateway/host/passed_message.h>

/// The protocol between a gateway and a driver host process, over a Unix domain socket in the gateway's state folder.
/// The host listens and serves one connection at a time. Who connects must have the user that made the socket, and
/// first prove that it is the gateway that started the host, or a later run of it; the host closes the connections of
/// others. Every frame (processes/frames.h) is one message in JSON: a struct below, whose fields are described once
/// (discovery/description/fields.h), and its `kind`. The host first sends HostHello, so that a restarted gateway knows
/// what runs. A host goes on when its gateway ends.
namespace iotcloud::gateway::protocol {

/// Increased with every incompatible change. A gateway ends a host that has another version instead of adopting it. A
/// change of keys is incompatible; a new field that may be missing is not.
inline constexpr int version = 6;

// ---- from the gateway

/// What only this host's gateway knows (HostProofs); a connection's first message.
struct ProveGateway {
  std::string proof;
  static constexpr const char* kind = "prove";
  static constexpr const char* what = "a gateway's proof";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(proof, usual)};
};

struct CreateInstance {
  InstanceSpec spec;
  static constexpr const char* kind = "create";
  static constexpr const char* what = "a command to create an instance";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(spec, required)};
};

struct ActivateInstance {
  discovery::InstanceId instance;
  static constexpr const char* kind = "activate";
  static constexpr const char* what = "a command to activate an instance";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, usual)};
};

struct DeactivateInstance {
  discovery::InstanceId instance;
  static constexpr const char* kind = "deactivate";
  static constexpr const char* what = "a command to deactivate an instance";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, usual)};
};

struct RemoveInstance {
  discovery::InstanceId instance;
  Removal removal = Removal::replaced;
  static constexpr const char* kind = "remove";
  static constexpr const char* what = "a command to remove an instance";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(instance, usual), IOTCLOUD_FIELD_AS(removal, rare, "number", removal)};
};

/// The host stops its instances and ends.
struct ShutDown {
  std::chrono::milliseconds limit{0};
  static constexpr const char* kind = "shutdown";
  static constexpr const char* what = "a command to shut down";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_AS(limit, usual, "number", limit)};
};

struct Ping {
  std::int64_t number = 0;  ///< repeated in the Pong
  static constexpr const char* kind = "ping";
  static constexpr const char* what = "a ping";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(number, rare)};
};

/// Asks for HostSamples.
struct AskForSamples {
  static constexpr const char* kind = "metrics";
  static constexpr const char* what = "a question for metrics";
  static constexpr std::tuple<> fields{};
};

/// A message that another host read.
struct DeliverMessage {
  PassedMessage passed;
  static constexpr const char* kind = "deliver";
  static constexpr const char* what = "a command to deliver a message";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(passed, required)};
};

/// The registry has confirmed the gateway's place.
struct RenewLeases {
  std::chrono::nanoseconds confirmed{0};  ///< when, by this machine's monotonic clock
  static constexpr const char* kind = "renew";
  static constexpr const char* what = "a renewal of leases";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_AS(confirmed, usual, "number", confirmed)};
};

/// The form of a message that a person hands to an instance: a passed message that nobody passed.
struct AsPassedMessage {
  static PassedMessage to(const std::optional<brokers::Message>& message) { return {0, "", *message}; }
  static void from(PassedMessage passed, std::optional<brokers::Message>& message) {
    message = std::move(passed.message);
  }
};

/// Asks for a ChannelAnswer of the same number.
struct AskAboutChannel {
  std::int64_t number = 0;
  ChannelQuestion question;
  static constexpr const char* kind = "ask";
  static constexpr const char* what = "a question about a channel";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(number, usual), IOTCLOUD_FIELD_AS(question.look, required, "question", question),
                 IOTCLOUD_FIELD_IN(AsPassedMessage, question.message, rare, "message", message)};
};

// ---- in both directions

/// What became of a message that was passed on: from the gateway, of one that this host has passed; from the host, of
/// one that was delivered to it.
struct AnswerMessage {
  std::int64_t number = 0;  ///< PassedMessage::number
  PassAnswer answer{};
  static constexpr const char* kind = "answer";
  static constexpr const char* what = "an answer to a passed message";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(number, usual), IOTCLOUD_FIELD(answer, required)};
};

// ---- from the host

/// The host's first message. From a host that has another version only that is read.
struct HostHello {
  int version = protocol::version;
  HostOrder order;
  bool answers = false;  ///< it understands AskAboutChannel, which came later
  std::vector<HostedInstance> instances;
  static constexpr const char* kind = "hello";
  static constexpr const char* what = "the greeting of a driver host";
  static constexpr auto fields =
      std::tuple_cat(std::tuple{IOTCLOUD_FIELD(version, required)}, IOTCLOUD_FIELDS_OF(order, HostOrder),
                     std::tuple{IOTCLOUD_FIELD(answers, usual), IOTCLOUD_FIELD(instances, required)});
};

/// The plugin cannot be loaded; the host waits to be shut down.
struct PluginRefused {
  std::string reason;
  static constexpr const char* kind = "refused";
  static constexpr const char* what = "a refusal of a plugin";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(reason, required)};
};

struct StatusChange {
  InstanceStatus status;
  static constexpr const char* kind = "status";
  static constexpr const char* what = "a change of an instance's status";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(status, required)};
};

struct Pong {
  std::int64_t number = 0;    ///< Ping::number
  std::vector<Stall> stalls;  ///< the event threads that are stuck
  std::vector<BrokerLink> brokers{};
  std::vector<LosingChannel> losing{};
  static constexpr const char* kind = "pong";
  static constexpr const char* what = "a pong";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(number, required), IOTCLOUD_FIELD(stalls, required),
                                            IOTCLOUD_FIELD(brokers, rare), IOTCLOUD_FIELD(losing, rare)};
};

/// The form of the samples of metrics.
struct AsSampleList {
  static nlohmann::json to(const std::vector<config::Sample>& samples);
  static void from(const nlohmann::json& list, std::vector<config::Sample>& samples);
};

/// All samples of the host's process.
struct HostSamples {
  std::vector<config::Sample> samples;
  static constexpr const char* kind = "metrics";
  static constexpr const char* what = "the metrics of a driver host";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_IN(AsSampleList, samples, required, "samples", samples)};
};

/// A message for an instance of another host.
struct PassMessage {
  PassedMessage passed;
  static constexpr const char* kind = "pass";
  static constexpr const char* what = "a message to pass on";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(passed, required)};
};

struct ChannelAnswer {
  std::int64_t number = 0;  ///< AskAboutChannel::number
  discovery::ChannelLook look;
  static constexpr const char* kind = "told";
  static constexpr const char* what = "an answer about a channel";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(number, required), IOTCLOUD_FIELD_IN(WithBase64, look, required, "look", look)};
};

/// What an instance that is a finder tells.
struct FoundMessage {
  FoundReport report;
  static constexpr const char* kind = "found";
  static constexpr const char* what = "what a finder found";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(report, required)};
};

// ---- all of them

/// A message from the gateway.
using HostCommand =
    std::variant<CreateInstance, ActivateInstance, DeactivateInstance, RemoveInstance, ShutDown, Ping, AskForSamples,
                 DeliverMessage, AnswerMessage, RenewLeases, AskAboutChannel, ProveGateway>;
/// A message from the host.
using HostReport = std::variant<HostHello, PluginRefused, StatusChange, Pong, HostSamples, PassMessage, AnswerMessage,
                                ChannelAnswer, FoundMessage>;

/// Encodes a complete frame. Bytes that are not UTF-8 are replaced.
std::string encode(const HostCommand& command);
std::string encode(const HostReport& report);
/// Decodes the body of a frame. \throws config::Error if it is malformed.
HostCommand decode_command(const std::string& body);
HostReport decode_report(const std::string& body);

}  // namespace iotcloud::gateway::protocol
