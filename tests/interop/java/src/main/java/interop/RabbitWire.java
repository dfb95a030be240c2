package interop;

import com.rabbitmq.client.AMQP;
import com.rabbitmq.client.Channel;
import com.rabbitmq.client.Connection;
import com.rabbitmq.client.ConnectionFactory;
import interop.original.TChannel;
import java.util.HashMap;
import java.util.Map;
import java.util.function.Consumer;

/** A direct exchange, and one queue that reader and writer declare alike: not durable, deleted with its last reader. */
final class RabbitWire implements Wire {
    private final Connection connection;
    private final Channel reading;
    private final Channel writing;

    RabbitWire(String url) throws Exception {
        var factory = new ConnectionFactory();
        factory.setUri(url);
        factory.setAutomaticRecoveryEnabled(false);
        connection = factory.newConnection();
        reading = connection.createChannel();
        writing = connection.createChannel();
    }

    private static void declare(Channel on, TChannel channel) throws Exception {
        String exchange = channel.getProperties().get("exchange");
        String queue = Wire.name(channel, "queueName");
        on.exchangeDeclare(exchange, "direct", false);
        on.queueDeclare(queue, false, false, true, null);
        on.queueBind(queue, exchange, Wire.name(channel, "routingKey"));
    }

    @Override
    public void read(TChannel channel, Consumer<Message> handler) throws Exception {
        declare(reading, channel);
        reading.basicConsume(Wire.name(channel, "queueName"), false, (tag, delivery) -> {
            Map<String, String> headers = new HashMap<>();
            delivery.getProperties().getHeaders().forEach((name, value) -> headers.put(name, value.toString()));
            handler.accept(new Message(delivery.getBody(), headers));
            reading.basicAck(delivery.getEnvelope().getDeliveryTag(), false);
        }, tag -> {});
    }

    @Override
    public void open(TChannel channel) throws Exception {
        declare(writing, channel);
    }

    @Override
    public synchronized void write(TChannel channel, Message message) throws Exception {
        Map<String, Object> headers = new HashMap<>(message.headers());
        writing.basicPublish(channel.getProperties().get("exchange"), Wire.name(channel, "routingKey"),
                new AMQP.BasicProperties.Builder().headers(headers).build(), message.body());
    }

    @Override
    public void close() throws Exception {
        connection.close();
    }
}
