/** What a record of Kafka holds, as the original system writes it (REFERENCE: TBinaryProtocol, without framing). */
namespace cpp iotcloud.brokers.envelope

struct TSensorMessage {
  1: string sensorId
  2: string site
  3: binary body
  4: optional map<string, string> properties
}
