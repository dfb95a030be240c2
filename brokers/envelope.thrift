/** What a record of Kafka holds, as the original system writes it in Thrift's binary protocol without framing
    (docs/wire.md#envelope). */
namespace cpp iotcloud.brokers.envelope

struct TSensorMessage {
  1: string sensorId
  2: string site
  3: binary body
  4: optional map<string, string> properties
}
